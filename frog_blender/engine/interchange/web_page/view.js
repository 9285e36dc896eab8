// Where the scene is looked at from. Axes of cameras are OpenCV's: x right, y down, z forward.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const plus = (a, b, scale = 1) => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];
const unit = (a) => a.map((value) => value / (Math.hypot(...a) || 1));

/** A vector turned about a unit axis (Rodrigues). */
function turned(vector, axis, angle) {
  const cosine = Math.cos(angle);
  const along = plus(vector.map((value) => value * cosine), cross(axis, vector), Math.sin(angle));
  return plus(along, axis, dot(axis, vector) * (1 - cosine));
}

class View {
  constructor(description) {
    this.start = description.view;
    this.cameras = description.cameras;
    this.up = this.start.up;
    this.look(0);
  }

  /** Looks through a camera of the capture; from a distance where there is none. */
  look(index) {
    this.target = [...this.start.target];
    const camera = this.cameras[index] ?? this.start.camera;
    const { intrinsics: k, world_to_camera: pose } = camera;
    const [x, y, z] = pose;
    this.axes = [x, y, z].map((row) => row.slice(0, 3));
    this.center = [0, 1, 2].map((axis) => -(x[axis] * x[3] + y[axis] * y[3] + z[axis] * z[3]));
    this.lens = { size: [camera.width, camera.height], intrinsics: [k[0][0], k[1][1], k[0][2], k[1][2]] };
    this.exposure = camera.exposure ?? [1, 1, 1];
  }

  /** Turns about the target; angles in radians. */
  orbit(across, down) {
    this.turn(this.up, across);
    const steep = dot(this.axes[2], this.up); // the sine of how far one looks up
    const limit = 0.998;
    if ((steep > limit && down < 0) || (steep < -limit && down > 0)) return;
    this.turn(this.axes[0], down);
  }

  turn(axis, angle) {
    this.axes = this.axes.map((own) => unit(turned(own, axis, angle)));
    this.center = plus(this.target, turned(plus(this.center, this.target, -1), axis, angle));
  }

  /** Moves sideways by shares of the distance to the target. */
  pan(right, down) {
    const distance = Math.hypot(...plus(this.center, this.target, -1));
    for (const [axis, share] of [[0, right], [1, down]]) {
      this.center = plus(this.center, this.axes[axis], share * distance);
      this.target = plus(this.target, this.axes[axis], share * distance);
    }
  }

  /** Goes nearer for factors below one. */
  dolly(factor) {
    this.center = plus(this.target, plus(this.center, this.target, -1), factor);
  }

  /** fx, fy, cx, cy in pixels of a canvas, in which the whole image of the lens lies. */
  intrinsics(width, height) {
    const { size, intrinsics } = this.lens;
    const scale = Math.min(width / size[0], height / size[1]);
    const [left, top] = [(width - scale * size[0]) / 2, (height - scale * size[1]) / 2];
    const [fx, fy, cx, cy] = intrinsics.map((value) => value * scale);
    return [fx, fy, cx + left, cy + top];
  }
}
