// The head: linear shapes and linear blend skinning over a tree of joints, as samira_warp/head/rig.py has them,
// and a frame for every triangle, as samira_warp/kernels/mesh/triangle_frames.py has them.

const DEGENERATE = 1e-5; // a triangle lower than this share of its sides has no normal

export class Head {
  constructor(description, arrays) {
    this.arrays = arrays;
    this.parents = description.joints.map((joint) => joint.parent);
    this.hasCorrectives = description.correctives;
    this.unposed = new Float32Array(arrays.vertices.length);
    this.vertices = new Float32Array(arrays.vertices.length);
    this.faceCount = arrays.faces.length / 3;
    // by face, the rows of [k r | t]: what takes a splat from its triangle to the world
    this.frames = new Float32Array(this.faceCount * 12);
  }

  // Pose it: three numbers of translation, three of each joint's axis-angle, one of each expression.
  pose({translation, rotations, expression}) {
    const turns = this.parents.map((_, joint) => rotationMatrix(rotations, 3 * joint));
    this.#shape(expression, turns);
    const skinning = this.#chain(expression, turns, translation);
    this.#skin(skinning);
    this.#triangles();
    return skinning;
  }

  #shape(expression, turns) {
    const {vertices, shapes, shape_scales: scales} = this.arrays;
    const weights = Array.from(expression);
    if (this.hasCorrectives) {
      for (const turn of turns.slice(1)) weights.push(...turn.map((entry, i) => entry - (i % 4 === 0 ? 1 : 0)));
    }
    const unposed = this.unposed;
    unposed.set(vertices);
    weights.forEach((weight, shape) => {
      const factor = weight * scales[shape];
      if (factor === 0) return;
      const start = shape * unposed.length;
      for (let i = 0; i < unposed.length; i++) unposed[i] += factor * shapes[start + i];
    });
  }

  // [R | t] of each joint, twelve numbers by rows: its own turn about where it is, then its ancestors'.
  #chain(expression, turns, translation) {
    const {joint_places: places, joint_shifts: shifts} = this.arrays;
    const transforms = [];
    turns.forEach((turn, joint) => {
      const place = [0, 1, 2].map((axis) => {
        let value = places[3 * joint + axis];
        expression.forEach((weight, e) => { value += weight * shifts[3 * (e * turns.length + joint) + axis]; });
        return value;
      });
      const own = new Float64Array(12);
      for (let row = 0; row < 3; row++) {
        let turned = 0;
        for (let column = 0; column < 3; column++) {
          own[4 * row + column] = turn[3 * row + column];
          turned += turn[3 * row + column] * place[column];
        }
        own[4 * row + 3] = place[row] - turned;
      }
      const parent = this.parents[joint];
      transforms.push(parent < 0 ? own : product(transforms[parent], own));
    });
    for (const transform of transforms) for (let row = 0; row < 3; row++) transform[4 * row + 3] += translation[row];
    return transforms;
  }

  #skin(transforms) {
    const {weights} = this.arrays, {unposed, vertices} = this, joints = transforms.length;
    for (let v = 0; v < vertices.length / 3; v++) {
      const x = unposed[3 * v], y = unposed[3 * v + 1], z = unposed[3 * v + 2];
      let px = 0, py = 0, pz = 0;
      for (let joint = 0; joint < joints; joint++) {
        const w = weights[v * joints + joint];
        if (w === 0) continue;
        const m = transforms[joint];
        px += w * (m[0] * x + m[1] * y + m[2] * z + m[3]);
        py += w * (m[4] * x + m[5] * y + m[6] * z + m[7]);
        pz += w * (m[8] * x + m[9] * y + m[10] * z + m[11]);
      }
      vertices[3 * v] = px; vertices[3 * v + 1] = py; vertices[3 * v + 2] = pz;
    }
  }

  // r has the columns (first edge, normal, third axis); k is half the first edge and the height over it.
  #triangles() {
    const {faces} = this.arrays, {vertices: p, frames} = this;
    for (let face = 0; face < this.faceCount; face++) {
      const a = 3 * faces[3 * face], b = 3 * faces[3 * face + 1], c = 3 * faces[3 * face + 2];
      let ex = p[b] - p[a], ey = p[b + 1] - p[a + 1], ez = p[b + 2] - p[a + 2];
      const sx = p[c] - p[a], sy = p[c + 1] - p[a + 1], sz = p[c + 2] - p[a + 2];
      const length = Math.hypot(ex, ey, ez);
      if (length > 0) { ex /= length; ey /= length; ez /= length; }
      let nx = ey * sz - ez * sy, ny = ez * sx - ex * sz, nz = ex * sy - ey * sx;
      const height = Math.hypot(nx, ny, nz), k = 0.5 * (length + height);
      const f = 12 * face;
      if (length > 0 && height > DEGENERATE * Math.max(length, Math.hypot(sx, sy, sz))) {
        nx /= height; ny /= height; nz /= height;
        frames[f] = k * ex; frames[f + 1] = k * nx; frames[f + 2] = k * (ey * nz - ez * ny);
        frames[f + 4] = k * ey; frames[f + 5] = k * ny; frames[f + 6] = k * (ez * nx - ex * nz);
        frames[f + 8] = k * ez; frames[f + 9] = k * nz; frames[f + 10] = k * (ex * ny - ey * nx);
      } else {
        frames.fill(0, f, f + 12);
        frames[f] = frames[f + 5] = frames[f + 10] = k;
      }
      for (let axis = 0; axis < 3; axis++) frames[f + 4 * axis + 3] = (p[a + axis] + p[b + axis] + p[c + axis]) / 3;
    }
  }
}

// Nine numbers by rows, of an axis-angle vector in radians (Rodrigues).
function rotationMatrix(rotations, start) {
  const [x, y, z] = rotations.slice(start, start + 3);
  const angle = Math.hypot(x, y, z);
  const sine = angle < 1e-6 ? 1 : Math.sin(angle) / angle;
  const versine = angle < 1e-6 ? 0.5 : 2 * (Math.sin(angle / 2) / angle) ** 2;
  return [
    1 - versine * (y * y + z * z), versine * x * y - sine * z, versine * x * z + sine * y,
    versine * x * y + sine * z, 1 - versine * (x * x + z * z), versine * y * z - sine * x,
    versine * x * z - sine * y, versine * y * z + sine * x, 1 - versine * (x * x + y * y),
  ];
}

// Of two transforms [R | t], the right one first.
function product(left, right) {
  const result = new Float64Array(12);
  for (let row = 0; row < 3; row++) {
    for (let column = 0; column < 4; column++) {
      let sum = column === 3 ? left[4 * row + 3] : 0;
      for (let i = 0; i < 3; i++) sum += left[4 * row + i] * right[4 * i + column];
      result[4 * row + column] = sum;
    }
  }
  return result;
}
