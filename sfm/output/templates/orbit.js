// A camera that circles a point: turned by two angles about the upward axis, moved sideways, closer and back.
class Orbit {
  static STEEPEST = 1.55;  // of the angle below the horizon

  constructor({ up, ahead }) {
    const along = Orbit.dot(ahead, up);
    let level = Orbit.sum(ahead, up, -along);
    if (Math.hypot(...level) < 1e-6) level = Orbit.cross(up, Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]);
    this.up = up;
    this.level = Orbit.unit(level);
    this.right = Orbit.cross(this.level, up);
    Object.assign(this, { middle: [0, 0, 0], distance: 1, yaw: 0, pitch: 0 });
  }

  static dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  static cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
  static sum(a, b, scale = 1) { return a.map((value, k) => value + scale * b[k]); }
  static unit(a) { return a.map((value) => value / Math.hypot(...a)); }

  // Right, down and forward of the camera.
  axes() {
    const { up, level, right, yaw, pitch } = this;
    const away = Orbit.sum(level.map((value) => Math.cos(yaw) * value), right, Math.sin(yaw));
    const forward = Orbit.sum(away.map((value) => Math.cos(pitch) * value), up, -Math.sin(pitch));
    const aside = Orbit.sum(right.map((value) => Math.cos(yaw) * value), level, -Math.sin(yaw));
    return [aside, Orbit.cross(forward, aside), forward];
  }

  camera(intrinsic) {
    const axes = this.axes();
    return { intrinsic, rotation: axes.flat(), centre: Orbit.sum(this.middle, axes[2], -this.distance) };
  }

  // Look at a point from a distance.
  look(middle, distance, yaw, pitch) {
    Object.assign(this, { middle, distance, yaw, pitch });
  }

  // Continue from another camera, around its view at a distance; without its roll.
  follow({ rotation, centre }, distance) {
    const forward = rotation.slice(6);
    const below = Math.max(-1, Math.min(1, -Orbit.dot(forward, this.up)));
    this.pitch = Math.max(-Orbit.STEEPEST, Math.min(Orbit.STEEPEST, Math.asin(below)));
    this.yaw = Math.atan2(Orbit.dot(forward, this.right), Orbit.dot(forward, this.level));
    this.distance = distance;
    this.middle = Orbit.sum(centre, forward, distance);
  }

  turn(right, down) {
    this.yaw += right;
    this.pitch = Math.max(-Orbit.STEEPEST, Math.min(Orbit.STEEPEST, this.pitch + down));
  }

  // Move sideways by parts of the distance.
  shift(right, down) {
    const [aside, below] = this.axes();
    this.middle = Orbit.sum(Orbit.sum(this.middle, aside, right * this.distance), below, down * this.distance);
  }

  closer(factor, least) {
    this.distance = Math.max(least, this.distance * Math.exp(-factor));
  }
}
