// The frames: a slider through them, playing, and the picture of the one that is shown.
class Film {
  // changed() is called for another frame, pictured(image) when its picture is there.
  constructor(data, changed, pictured) {
    const element = (id) => document.getElementById(id);
    Object.assign(this, { data, changed, pictured, index: 0, playing: 0, since: 0 });
    [this.slider, this.button, this.label, this.image, this.caption] =
      ["frame", "play", "number", "picture", "caption"].map(element);
    this.slider.addEventListener("input", () => {
      this.pause();
      this.go(this.slider.valueAsNumber);
    });
    this.button.addEventListener("click", () => this.toggle());
  }

  load(piece) {
    this.pause();
    this.piece = piece;
    this.addresses = piece.pictures.map(({ picture }) => `data:image/webp;base64,${picture}`);
    Object.assign(this.slider, { min: 0, max: piece.frames.length - 1, step: 1 });
    this.go(0);
  }

  go(index) {
    const { frames } = this.piece;
    this.index = Math.max(0, Math.min(frames.length - 1, index));
    this.slider.value = String(this.index);
    const number = frames[this.index], rate = this.data.frames_per_second;
    const time = rate ? ` · ${(number / rate).toFixed(2)} s` : "";
    this.label.textContent = `frame ${number}${time}`;
    this.slider.setAttribute("aria-valuetext", this.label.textContent);
    this.picture(number);
    this.changed();
  }

  // The nearest picture; not all frames have one in a long sequence.
  async picture(number) {
    const away = this.piece.pictures.map(({ frame }) => Math.abs(frame - number));
    const best = away.indexOf(Math.min(...away)), address = this.addresses[best], image = new Image();
    this.caption.textContent = away[best] ? `picture of frame ${this.piece.pictures[best].frame}` : `frame ${number}`;
    if (this.address === address) return;
    this.address = address;
    this.isPending = true;
    image.src = address;
    await image.decode();
    if (this.address !== address) return;
    this.image.src = address;
    this.isPending = false;
    this.pictured(image);
  }

  get camera() {
    const { intrinsic, rotations, centres } = this.piece;
    return { intrinsic, rotation: rotations[this.index], centre: centres[this.index] };
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  pause() {
    cancelAnimationFrame(this.playing);
    this.playing = 0;
    this.button.textContent = "Play";
    this.button.setAttribute("aria-pressed", "false");
  }

  // Frames at their times, leaving out those that drawing has no time for.
  play() {
    const { frames } = this.piece, rate = this.data.frames_per_second ?? 25;
    if (this.index === frames.length - 1) this.go(0);
    const first = frames[this.index], start = performance.now();
    this.button.textContent = "Pause";
    this.button.setAttribute("aria-pressed", "true");
    const step = (now) => {
      const number = first + (now - start) / 1000 * rate;
      let index = this.index;
      while (index < frames.length - 1 && frames[index + 1] <= number) index++;
      if (index !== this.index) this.go(index);
      if (index === frames.length - 1) this.pause();
      else this.playing = requestAnimationFrame(step);
    };
    this.playing = requestAnimationFrame(step);
  }
}
