// The page: plays the sequence, adds what the sliders say to the frame that is shown, and goes round the head.

import {Avatar} from "./avatar.js";

const NEAREST = 0.25, FARTHEST = 10; // metres
const STEEPEST = 1.5; // radians above or below
const element = (id) => document.getElementById(id);

class Page {
  constructor(avatar) {
    this.avatar = avatar;
    this.added = {}; // by slider
    this.frame = 0;
    this.playing = false;
    this.orbit = orbitOf(avatar.description);
    this.#sliders();
    this.#controls();
    this.#mouse();
    new ResizeObserver(() => this.redraw()).observe(avatar.canvas);
    this.redraw();
  }

  // Draw before the next refresh of the screen, once.
  redraw() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => {
      this.asked = false;
      this.#advance(now);
      this.draw();
      if (this.playing) this.redraw();
    });
  }

  draw() {
    const {avatar} = this, {canvas} = avatar;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(Math.round(side * ratio), 1));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
    element("frame").value = this.frame;
    avatar.draw(this.parameters(), {...avatar.camera(), worldToCamera: viewFrom(this.orbit)});
  }

  // The frame's parameters and what the sliders add to them.
  parameters() {
    const parameters = this.avatar.frame(this.frame);
    const {expressions, controls} = this.avatar.description;
    for (const [label, value] of Object.entries(this.added)) {
      const control = controls.find((each) => each.label === label);
      if (control === undefined) parameters.expression[expressions.indexOf(label)] += value;
      else for (const joint of control.joints) turn(parameters.rotations, 3 * joint, control.axis, value * Math.PI / 180);
    }
    return parameters;
  }

  #advance(now) {
    const seconds = (now - (this.drawn ?? now)) / 1000;
    this.drawn = this.playing ? now : undefined;
    if (this.playing) this.frame = (this.frame + seconds * this.avatar.description.fps) % this.avatar.frameCount;
  }

  #sliders() {
    const {controls, sliders} = this.avatar.description;
    const joints = controls.map(({label, limit}) => [label, limit, 0.5]);
    const [main, more] = [sliders.main, sliders.more].map((rows) => rows.map(({name, limit}) => [name, limit, 0.01]));
    for (const [folder, rows] of Object.entries({joints, main, more})) {
      for (const row of rows) element(folder).append(this.#slider(...row));
      element(folder).parentElement.hidden = rows.length === 0;
    }
  }

  #slider(label, limit, step) {
    const input = Object.assign(document.createElement("input"), {type: "range", min: -limit, max: limit, step, value: 0});
    input.addEventListener("input", () => {
      this.added[label] = Number(input.value);
      this.redraw();
    });
    const row = document.createElement("label");
    row.append(label, input);
    return row;
  }

  #controls() {
    const frame = element("frame"), play = element("play");
    frame.max = this.avatar.frameCount - 1;
    frame.addEventListener("input", () => { this.frame = Number(frame.value); this.redraw(); });
    play.addEventListener("click", () => {
      this.playing = !this.playing;
      play.textContent = this.playing ? "Pause" : "Play";
      this.redraw();
    });
    element("reset").addEventListener("click", () => {
      this.added = {};
      for (const input of document.querySelectorAll("#panel label input")) input.value = 0;
      this.orbit = orbitOf(this.avatar.description);
      this.redraw();
    });
  }

  #mouse() {
    const {canvas} = this.avatar;
    let last;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      last = event;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      const pitch = this.orbit.pitch + 0.007 * (event.clientY - last.clientY);
      this.orbit.pitch = Math.min(Math.max(pitch, -STEEPEST), STEEPEST);
      this.orbit.yaw -= 0.007 * (event.clientX - last.clientX);
      last = event;
      this.redraw();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const distance = this.orbit.distance * Math.exp(0.001 * event.deltaY);
      this.orbit.distance = Math.min(Math.max(distance, NEAREST), FARTHEST);
      this.redraw();
    }, {passive: false});
  }
}

// Where the first frame's camera stands about the middle of the head: radians, and metres.
function orbitOf({camera, center}) {
  const w = camera.worldToCamera;
  const away = [0, 1, 2].map((axis) => -(w[axis] * w[3] + w[4 + axis] * w[7] + w[8 + axis] * w[11]) - center[axis]);
  const distance = Math.hypot(...away);
  return {center, distance, yaw: Math.atan2(away[0], away[2]), pitch: Math.asin(away[1] / distance)};
}

// World to camera, by rows, of a camera that looks at the middle; the world's up is up.
function viewFrom({center, distance, yaw, pitch}) {
  const [sy, cy, sp, cp] = [Math.sin(yaw), Math.cos(yaw), Math.sin(pitch), Math.cos(pitch)];
  const rows = [[cy, 0, -sy], [sy * sp, -cp, cy * sp], [-sy * cp, -sp, -cy * cp]];
  return rows.flatMap((row, i) => [...row, (i === 2 ? distance : 0) - row.reduce((sum, x, j) => sum + x * center[j], 0)]);
}

// Turn an axis-angle vector further about one of the joint's own axes.
function turn(rotations, start, axis, angle) {
  const vector = rotations.slice(start, start + 3), length = Math.hypot(...vector);
  const s = length > 1e-9 ? Math.sin(length / 2) / length : 0.5;
  const [w, x, y, z] = [Math.cos(length / 2), ...vector.map((value) => s * value)];
  const added = [0, 0, 0];
  added[axis] = Math.sin(angle / 2);
  const a = Math.cos(angle / 2), [b, c, d] = added;
  const q = [w * b + x * a + y * d - z * c, w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a];
  const real = w * a - x * b - y * c - z * d, sine = Math.hypot(...q);
  const factor = sine > 1e-9 ? 2 * Math.atan2(sine, real) / sine : 2;
  q.forEach((value, i) => { rotations[start + i] = factor * value; });
}

try {
  const avatar = await Avatar.load("./", element("picture"));
  document.title = avatar.description.name;
  window.page = new Page(avatar);
  element("message").hidden = true;
} catch (error) {
  element("message").textContent = error.message;
  throw error;
}
