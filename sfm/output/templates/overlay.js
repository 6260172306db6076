// Points, lines and pictures in the world, drawn between surfaces.
class Overlay {
  constructor(gl, renderer, shaders) {
    Object.assign(this, { gl, renderer, picture: null });
    this.world = renderer.program(shaders["world.vert"], shaders["world.frag"]);
  }

  // Positions, three numbers each, and colours, four bytes each.
  upload(positions, colours) {
    const { gl } = this, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    [[positions, 3, gl.FLOAT, false], [colours, 4, gl.UNSIGNED_BYTE, true]].forEach(([values, size, kind, isShare], place) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, kind, isShare, 0, 0);
    });
    gl.bindVertexArray(null);
    return { array, count: positions.length / 3 };
  }

  // The cloud of a piece: columns of its high and low bytes and of its colours.
  static async cloud({ count, low, unit, codes }) {
    const bytes = await Decoding.inflated(Decoding.bytesOf(codes));
    const positions = new Float32Array(3 * count), colours = new Uint8Array(4 * count).fill(255);
    for (let k = 0; k < count; k++) {
      for (let axis = 0; axis < 3; axis++) {
        const code = 256 * bytes[2 * axis * count + k] + bytes[(2 * axis + 1) * count + k];
        positions[3 * k + axis] = low[axis] + (code - 1) * unit[axis];
        colours[4 * k + axis] = bytes[(6 + axis) * count + k];
      }
    }
    return { positions, colours };
  }

  // The corners of a picture at a distance before its camera, row by row.
  static corners({ intrinsic, rotation, centre }, { width, height }, distance) {
    const back = Matrices.times(Matrices.transposed(rotation), Matrices.inverse(intrinsic));
    return [[-0.5, -0.5], [width - 0.5, -0.5], [-0.5, height - 0.5], [width - 0.5, height - 0.5]]
      .map(([x, y]) => Orbit.sum(centre, Matrices.apply(back, [x, y, 1]), distance));
  }

  // Lines of cameras as pyramids, each with its colour.
  pyramids(cameras, size, distance, colour) {
    const lines = cameras.flatMap((camera) => {
      const [a, b, c, d] = Overlay.corners(camera, size, distance), { centre } = camera;
      return [centre, a, centre, b, centre, c, centre, d, a, b, b, d, d, c, c, a];
    });
    return this.lines(lines, colour);
  }

  lines(places, colour) {
    const colours = Uint8Array.from(places.flatMap(() => [...colour, 255]));
    return this.upload(Float32Array.from(places.flat()), colours);
  }

  release({ array }) {
    this.gl.deleteVertexArray(array);
  }

  show(image) {
    const { gl } = this;
    this.picture ??= this.renderer.texture(gl.LINEAR);
    gl.bindTexture(gl.TEXTURE_2D, this.picture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE, image);
  }

  // The picture before its camera.
  drawPicture(view, places) {
    const corners = new Uint8Array([0, 0, 0, 255, 255, 0, 0, 255, 0, 255, 0, 255, 255, 255, 0, 255]);
    const shape = this.upload(Float32Array.from(places.flat()), corners);
    this.renderer.bind(0, this.gl.TEXTURE_2D, this.picture);
    this.draw(view, shape, this.gl.TRIANGLE_STRIP, { isPictured: true });
    this.release(shape);
  }

  draw(view, { array, count }, kind, { diameter = 0, sizes = [1, 1], behind = 1, isPictured = false }) {
    const { gl, renderer } = this;
    const turn = Matrices.times(view.intrinsic, view.rotation);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.GREATER);
    this.world({
      u_turn: turn, u_shift: Matrices.apply(turn, view.centre).map((value) => -value),
      u_size: [gl.canvas.width / renderer.scale, gl.canvas.height / renderer.scale], u_reach: renderer.reach,
      u_behind: behind, u_diameter: diameter, u_sizes: sizes,
      u_round: kind === gl.POINTS, u_pictured: isPictured, u_picture: 0,
    });
    gl.bindVertexArray(array);
    gl.drawArrays(kind, 0, count);
    gl.bindVertexArray(null);
  }
}
