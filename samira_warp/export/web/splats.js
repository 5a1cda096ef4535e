// Gaussians bound to triangles, blended back to front as samira_warp/kernels/raster blends them: projected with
// the Jacobian of the pinhole, spread by a pixel's own square. Colours are linear; the picture is encoded last.

const LOW_PASS = 0.1, ALPHA_MIN = 1 / 255, ALPHA_MAX = 0.99, NEAR = 0.01;
const ROW = 1024; // splats, or faces, in a row of their texture
const SPLAT_TEXELS = 4, FACE_TEXELS = 3;

const SPLAT_VERTEX = `#version 300 es
precision highp float;
precision highp int;
uniform sampler2D splats, frames;
uniform mat4x3 view;        // world to camera: x right, y down, z forward
uniform vec4 lens;          // fx, fy, cx, cy in pixels
uniform vec2 size;          // of the picture, pixels
in uint splat;
out vec3 color;
out vec4 conic;             // xx, xy, yy, opacity
out vec2 offset;            // from the mean, pixels

mat3 rotation(vec4 q) {     // w, x, y, z
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec4 texel(sampler2D map, int index, int width, int part) {
  return texelFetch(map, ivec2((index % ${ROW}) * width + part, index / ${ROW}), 0);
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);   // beyond the picture, for all that cannot be seen
  int id = int(splat);
  vec4 place = texel(splats, id, ${SPLAT_TEXELS}, 0), turn = texel(splats, id, ${SPLAT_TEXELS}, 1);
  vec4 shape = texel(splats, id, ${SPLAT_TEXELS}, 2);
  color = texel(splats, id, ${SPLAT_TEXELS}, 3).rgb;
  int face = int(shape.w);
  mat3x4 rows = mat3x4(texel(frames, face, ${FACE_TEXELS}, 0), texel(frames, face, ${FACE_TEXELS}, 1),
                       texel(frames, face, ${FACE_TEXELS}, 2));
  mat4x3 frame = transpose(rows);
  vec3 point = view * vec4(frame * vec4(place.xyz, 1.0), 1.0);
  if (!(point.z > ${NEAR})) return;

  vec2 focal = lens.xy, margin = 0.15 * size / focal;
  vec2 slopes = clamp(point.xy / point.z, -lens.zw / focal - margin, (size - lens.zw) / focal + margin);
  mat3 axes = mat3(view) * mat3(frame) * rotation(normalize(turn)) * mat3(shape.x, 0, 0, 0, shape.y, 0, 0, 0, shape.z);
  mat3 turned = transpose(axes);
  vec3 m0 = focal.x / point.z * (turned[0] - slopes.x * turned[2]);
  vec3 m1 = focal.y / point.z * (turned[1] - slopes.y * turned[2]);
  float area = dot(cross(m0, m1), cross(m0, m1));
  float xx = dot(m0, m0) + ${LOW_PASS}, xy = dot(m0, m1), yy = dot(m1, m1) + ${LOW_PASS};
  float determinant = area + ${LOW_PASS} * (dot(m0, m0) + dot(m1, m1)) + ${LOW_PASS * LOW_PASS};
  float opacity = place.w * sqrt(area / determinant);
  if (!(opacity >= ${ALPHA_MIN})) return;
  conic = vec4(yy / determinant, -xy / determinant, xx / determinant, opacity);

  vec2 reach = sqrt(2.0 * log(opacity * 255.0) * vec2(xx, yy));
  offset = reach * vec2(gl_VertexID % 2 * 2 - 1, gl_VertexID / 2 * 2 - 1);
  vec2 pixel = focal * point.xy / point.z + lens.zw + offset;
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
}`;

const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
in vec3 color;
in vec4 conic;
in vec2 offset;
out vec4 blended;
void main() {
  float sigma = 0.5 * (conic.x * offset.x * offset.x + conic.z * offset.y * offset.y) + conic.y * offset.x * offset.y;
  float alpha = min(conic.w * exp(-sigma), ${ALPHA_MAX});
  if (alpha < ${ALPHA_MIN}) discard;
  blended = vec4(color * alpha, alpha);
}`;

const SHOW_VERTEX = `#version 300 es
void main() { gl_Position = vec4(4 * (gl_VertexID % 2) - 1, 4 * (gl_VertexID / 2) - 1, 0, 1); }`;

const SHOW_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D linear;
uniform vec3 background;    // display values
uniform bool encoded;
out vec4 shown;
void main() {
  vec4 sum = texelFetch(linear, ivec2(gl_FragCoord.xy), 0);
  vec3 color = max(sum.rgb / max(sum.a, ${ALPHA_MIN}), 0.0);
  vec3 curve = mix(12.92 * color, 1.055 * pow(color, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, color));
  shown = vec4(mix(background, encoded ? curve : color, sum.a), 1.0);
}`;

export class SplatView {
  // arrays: splat_faces, splat_means, splat_quaternions, splat_scales, splat_opacities, splat_colors.
  constructor(canvas, description, arrays) {
    const gl = canvas.getContext("webgl2", {antialias: false, preserveDrawingBuffer: true});
    if (!gl) throw new Error("This browser has no WebGL 2.");
    if (!gl.getExtension("EXT_color_buffer_float") && !gl.getExtension("EXT_color_buffer_half_float")) {
      throw new Error("This browser cannot draw into half floats.");
    }
    Object.assign(this, {canvas, gl, arrays, description, background: description.background});
    this.count = arrays.splat_faces.length;
    this.order = new Uint32Array(this.count);
    this.keys = new Float32Array(this.count);
    this.program = link(gl, SPLAT_VERTEX, SPLAT_FRAGMENT);
    this.showing = link(gl, SHOW_VERTEX, SHOW_FRAGMENT);
    this.splats = floatTexture(gl);
    upload(gl, this.splats, this.#packed(), this.count, SPLAT_TEXELS);
    this.frames = floatTexture(gl);
    this.target = gl.createFramebuffer();
    this.#attributes();
    this.targetSize = [0, 0];
  }

  // Draw the splats on triangles with frames (rows of [k r | t]) as a camera sees them.
  draw(frames, {worldToCamera, fx, fy, cx, cy}) {
    const {gl, canvas} = this, {width, height} = canvas;
    upload(gl, this.frames, frames, frames.length / (4 * FACE_TEXELS), FACE_TEXELS);
    this.#sort(frames, worldToCamera);
    this.#resize(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.useProgram(this.program);
    bind(gl, this.program, {splats: this.splats, frames: this.frames});
    const columns = [0, 1, 2, 3].flatMap((c) => [0, 1, 2].map((r) => worldToCamera[4 * r + c]));
    gl.uniformMatrix4x3fv(gl.getUniformLocation(this.program, "view"), false, columns);
    gl.uniform4f(gl.getUniformLocation(this.program, "lens"), fx, fy, cx, cy);
    gl.uniform2f(gl.getUniformLocation(this.program, "size"), width, height);
    gl.bindVertexArray(this.vertexArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.orderBuffer);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, this.order);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.BLEND);
    gl.useProgram(this.showing);
    bind(gl, this.showing, {linear: this.picture});
    gl.uniform3fv(gl.getUniformLocation(this.showing, "background"), this.background);
    gl.uniform1i(gl.getUniformLocation(this.showing, "encoded"), this.description.encoded);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  #packed() {
    const a = this.arrays, packed = new Float32Array(this.count * 4 * SPLAT_TEXELS);
    for (let i = 0; i < this.count; i++) {
      const p = 16 * i;
      packed.set(a.splat_means.subarray(3 * i, 3 * i + 3), p);
      packed[p + 3] = a.splat_opacities[i];
      packed.set(a.splat_quaternions.subarray(4 * i, 4 * i + 4), p + 4);
      packed.set(a.splat_scales.subarray(3 * i, 3 * i + 3), p + 8);
      packed[p + 11] = a.splat_faces[i];
      packed.set(a.splat_colors.subarray(3 * i, 3 * i + 3), p + 12);
    }
    return packed;
  }

  #attributes() {
    const {gl} = this;
    this.nothing = gl.createVertexArray();
    this.vertexArray = gl.createVertexArray();
    this.orderBuffer = gl.createBuffer();
    gl.bindVertexArray(this.vertexArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.orderBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, this.order.byteLength, gl.DYNAMIC_DRAW);
    const place = gl.getAttribLocation(this.program, "splat");
    gl.enableVertexAttribArray(place);
    gl.vertexAttribIPointer(place, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(place, 1);
  }

  // The order of the splats, the farthest first: a counting sort of depths in 65,536 steps, which is stable.
  #sort(frames, w) {
    const {splat_faces: faces, splat_means: means} = this.arrays, {keys, order} = this;
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < this.count; i++) {
      const f = 12 * faces[i], x = means[3 * i], y = means[3 * i + 1], z = means[3 * i + 2];
      let depth = w[11];
      for (let row = 0; row < 3; row++) {
        const r = f + 4 * row;
        depth += w[8 + row] * (frames[r] * x + frames[r + 1] * y + frames[r + 2] * z + frames[r + 3]);
      }
      keys[i] = depth;
      if (depth < low) low = depth;
      if (depth > high) high = depth;
    }
    const steps = 65535, scale = high > low ? steps / (high - low) : 0;
    const starts = new Uint32Array(steps + 2);
    for (let i = 0; i < this.count; i++) starts[((high - keys[i]) * scale | 0) + 1]++;
    for (let step = 0; step < steps; step++) starts[step + 1] += starts[step];
    for (let i = 0; i < this.count; i++) order[starts[(high - keys[i]) * scale | 0]++] = i;
  }

  #resize(width, height) {
    const {gl} = this;
    if (this.targetSize[0] === width && this.targetSize[1] === height) return;
    this.targetSize = [width, height];
    gl.deleteTexture(this.picture);
    this.picture = floatTexture(gl);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.picture, 0);
  }
}

function floatTexture(gl) {
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
  return texture;
}

// Fill a texture with so many entries of some texels each, ROW of them in a row.
function upload(gl, texture, values, count, texels) {
  gl.bindTexture(gl.TEXTURE_2D, texture);
  const rows = Math.max(Math.ceil(count / ROW), 1), width = ROW * texels;
  if (texture.rows !== rows) {
    texture.rows = rows;
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, rows);
  }
  const whole = Math.floor(count / ROW), rest = count - whole * ROW;
  if (whole) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, whole, gl.RGBA, gl.FLOAT, values);
  if (rest) {
    const last = values.subarray(whole * width * 4);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, whole, rest * texels, 1, gl.RGBA, gl.FLOAT, last);
  }
}

function bind(gl, program, textures) {
  Object.entries(textures).forEach(([name, texture], unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniform1i(gl.getUniformLocation(program, name), unit);
  });
}

function link(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}
