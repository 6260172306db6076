// Pictures with depth: those nearest to a view are unpacked one after the other, and those used last are kept.
class Sources {
  static MAX_KEPT = 12;
  static SAME = 1e-3;  // a view so near to a picture is its own

  // depth: a usual one, that differences in place are compared with; changed() is called when one more is there.
  constructor(renderer, sources, scene, depth, changed) {
    Object.assign(this, { renderer, sources, scene, depth, changed, kept: new Map(), isBusy: false, wanted: [] });
  }

  // How different two views are: by place and by direction.
  away(camera, { rotation, centre }) {
    const apart = Math.hypot(...Matrices.minus(centre, camera.centre)) / this.depth;
    const turned = 2 * (1 - Orbit.dot(rotation.slice(6), camera.rotation.slice(6)));
    return Math.sqrt(apart * apart + Math.max(0, turned));
  }

  // Those to draw a view from, the nearest first, as the renderer takes them.
  warps(view) {
    const sorted = this.sources.map(({ camera }, index) => ({ index, away: this.away(view, camera) }))
      .sort((a, b) => a.away - b.away).slice(0, Renderer.MAX_SOURCES);
    this.wanted = sorted.map(({ index }) => index).filter((index) => !this.kept.has(index));
    this.unpack();
    const near = 1e-3 * Math.max(...sorted.map(({ away }) => away), 1e-9);
    return sorted.filter(({ index }) => this.kept.has(index)).map(({ index, away }) => {
      const source = this.kept.get(index);
      this.kept.delete(index);  // and last again
      this.kept.set(index, source);
      const { turn, shift } = Matrices.between(this.sources[index].camera, view);
      return { source, turn, shift, back: Matrices.inverse(turn), weight: near / (away + near), away };
    });
  }

  get isComplete() {
    return this.wanted.length === 0;
  }

  async unpack() {
    if (this.isBusy || !this.wanted.length) return;
    this.isBusy = true;
    const [index] = this.wanted;
    try {
      const { pieces } = await Decoding.source(this.sources[index], this.scene, null);
      this.kept.set(index, this.renderer.upload(pieces));
      while (this.kept.size > Sources.MAX_KEPT) {
        const [oldest] = this.kept.keys();
        this.renderer.release(this.kept.get(oldest));
        this.kept.delete(oldest);
      }
    } finally {
      this.isBusy = false;
    }
    this.changed();
  }
}
