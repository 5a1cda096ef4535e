// An exported avatar in a canvas: reads avatar.json and avatar.bin, poses the head and draws its splats.
// For a page of one's own:
//
//   import {Avatar} from "./avatar.js";
//   const avatar = await Avatar.load("./", canvas);
//   avatar.draw(avatar.frame(12), avatar.camera());

import {Head} from "./head.js";
import {SplatView} from "./splats.js";

const TYPES = {float32: Float32Array, uint32: Uint32Array, int16: Int16Array};

export class Avatar {
  static async load(folder, canvas) {
    const [description, content] = await Promise.all([
      fetched(`${folder}avatar.json`).then((answer) => answer.json()),
      fetched(`${folder}avatar.bin`).then((answer) => answer.arrayBuffer()),
    ]);
    return new Avatar(description, content, canvas);
  }

  constructor(description, content, canvas) {
    this.description = description;
    this.arrays = Object.fromEntries(Object.entries(description.arrays).map(([name, {type, offset, shape}]) => {
      const count = shape.reduce((product, size) => product * size, 1);
      return [name, new TYPES[type](content, offset, count)];
    }));
    this.canvas = canvas;
    this.head = new Head(description, this.arrays);
    this.view = new SplatView(canvas, description, this.arrays);
    this.frameCount = description.frames.length;
  }

  // A frame of the sequence, between two of them where the number is no whole one.
  frame(number) {
    const before = Math.min(Math.floor(number), this.frameCount - 1), share = number - before;
    const after = Math.min(before + 1, this.frameCount - 1);
    const [here, next] = [before, after].map((row) => this.#row(row));
    const between = (name) => here[name].map((value, i) => value + share * (next[name][i] - value));
    return {
      translation: between("translation"), rotations: between("rotations"), expression: between("expression"),
    };
  }

  // The camera of the first frame, in a canvas of any shape: its longer side fits into the shorter one.
  camera() {
    const {worldToCamera, fx, fy, width, height} = this.description.camera, {canvas} = this;
    const scale = Math.min(canvas.width, canvas.height) / Math.max(width, height);
    return {worldToCamera, fx: fx * scale, fy: fy * scale, cx: canvas.width / 2, cy: canvas.height / 2};
  }

  draw(parameters, camera) {
    this.head.pose(parameters);
    this.view.draw(this.head.frames, camera);
  }

  #row(number) {
    const {frame_translations: t, frame_rotations: r, frame_expressions: e} = this.arrays;
    const row = (values, size) => Array.from(values.subarray(number * size, (number + 1) * size));
    const {joints, expressions} = this.description;
    return {translation: row(t, 3), rotations: row(r, 3 * joints.length), expression: row(e, expressions.length)};
  }
}

async function fetched(address) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`${address}: ${answer.status}`);
  return answer;
}
