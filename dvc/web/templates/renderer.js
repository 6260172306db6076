// Draws a scene by WebGL 2: sources into layers of a texture, then the view that they show together.
class Renderer {
  static MAX_SOURCES = 4;
  static CLOSED_PX = 1.5;  // on either side
  static BACKGROUND = [0.063, 0.071, 0.082];

  // A scene has a palette, its least and its largest disparity, and that of infinity. Surfaces that are `closest` times
  // as near as the nearest one of a source are not drawn.
  constructor(gl, scene, shaders, closest = 4) {
    Object.assign(this, { gl, scene, size: "" });
    this.reach = closest * (scene.highest - scene.infinity);
    this.surface = this.program(shaders["surface.vert"], shaders["surface.frag"]);
    const view = shaders["view.frag"], filling = view.replace("\n", "\n#define FILLS\n");
    this.view = this.program(shaders["view.vert"], filling);
    this.bare = this.program(shaders["view.vert"], view);  // much less to do, above all without a graphics processor
    this.palette = this.texture(gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, scene.palette);
    this.nothing = gl.createVertexArray();
    gl.vertexAttribI4i(0, 0, 0, 0, 0);  // of meshes, which have no cells: its kind must fit
  }

  program(vertex, fragment) {
    const { gl } = this, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program));
    const vectors = { [gl.FLOAT]: "uniform1fv", [gl.FLOAT_VEC2]: "uniform2fv", [gl.FLOAT_VEC3]: "uniform3fv" };
    const uniforms = new Map();
    for (let k = 0; k < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); k++) {
      const { name, type } = gl.getActiveUniform(program, k) ?? {};
      if (name) uniforms.set(name.replace("[0]", ""), { type, at: gl.getUniformLocation(program, name) });
    }
    // Use the program with values by the names of its uniforms; matrices are row by row.
    return (values) => {
      gl.useProgram(program);
      for (const [name, value] of Object.entries(values)) {
        const { type, at } = uniforms.get(name) ?? { at: null };
        if (type === gl.FLOAT_MAT3) gl.uniformMatrix3fv(at, true, value);
        else if (type in vectors) gl[vectors[type]](at, [value].flat());
        else gl.uniform1i(at, Number(value));
      }
    };
  }

  texture(filter) {
    const { gl } = this, texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    return texture;
  }

  // Upload the pieces of a source; return the source for warps.
  upload(pieces) {
    return pieces.map((piece) => this.uploaded(piece));
  }

  release(uploaded) {
    const { gl } = this;
    for (const { nearness, picture, whole, torn, buffers } of uploaded) {
      [nearness, picture].forEach((texture) => gl.deleteTexture(texture));
      [whole, torn].forEach((array) => gl.deleteVertexArray(array));
      buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    }
  }

  uploaded(piece) {
    const { gl } = this, buffers = [gl.createBuffer(), gl.createBuffer()];
    const nearness = this.texture(gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, piece.width, piece.height, 0, gl.RED, gl.FLOAT, piece.values);
    const picture = this.texture(gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE, piece.picture);
    const whole = gl.createVertexArray();
    gl.bindVertexArray(whole);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[0]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, piece.whole, gl.STATIC_DRAW);
    const torn = gl.createVertexArray();
    gl.bindVertexArray(torn);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[1]);
    gl.bufferData(gl.ARRAY_BUFFER, piece.torn, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 2, gl.INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.bindVertexArray(null);
    return { piece, nearness, picture, whole, torn, buffers };
  }

  // Texels of the view, how many of them a pixel of the sources has on a side, and layers for that many sources.
  resize(width, height, scale, count) {
    const { gl } = this;
    this.scale = scale;
    if (this.size === `${width}x${height}x${count}`) return;
    this.size = `${width}x${height}x${count}`;
    Object.assign(gl.canvas, { width, height });
    this.layers?.framebuffers.forEach((framebuffer) => gl.deleteFramebuffer(framebuffer));
    [this.layers?.colour, this.layers?.depth].forEach((texture) => texture && gl.deleteTexture(texture));
    const stack = (format) => {
      const texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
      gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, format, width, height, count);
      for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, name, gl.NEAREST);
      return texture;
    };
    const colour = stack(gl.RGBA8), depth = stack(gl.DEPTH_COMPONENT32F);
    const framebuffers = Array.from({ length: count }, (_, layer) => {
      const framebuffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, colour, 0, layer);
      gl.framebufferTextureLayer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, depth, 0, layer);
      return framebuffer;
    });
    this.layers = { colour, depth, framebuffers };
  }

  // warps: nearest first, each with a source that was uploaded; mode: "picture", "depth" or "lines"; holes, which no
  // source shows: "marked", "filled" by the background, "open", or "closed" if they are small; leads: whether the
  // first source is right at all pixels that it shows; tests: whether depths are kept for further drawing.
  draw(warps, { mode, holes, leads = false, tests = false }) {
    const { gl } = this;
    gl.viewport(0, 0, gl.canvas.width, gl.canvas.height);
    warps.forEach((warp, layer) => this.drawSource(warp, layer, mode === "lines"));
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.CULL_FACE);
    gl.depthFunc(gl.ALWAYS);
    gl.clearColor(...Renderer.BACKGROUND, 1);
    gl.clearDepth(0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    (tests ? gl.enable : gl.disable).call(gl, gl.DEPTH_TEST);
    if (warps.length) this.drawView(warps, mode, holes, leads);
  }

  drawSource(warp, layer, lines) {
    const { gl, surface } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.layers.framebuffers[layer]);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.depthFunc(gl.GREATER);
    gl.clearDepth(0);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const size = [gl.canvas.width / this.scale, gl.canvas.height / this.scale];
    surface({ u_turn: warp.turn, u_shift: warp.shift, u_size: size, u_reach: this.reach, u_lines: lines });
    surface({ u_nearness: 0, u_picture: 1 });
    for (const { piece, nearness, picture, whole, torn } of warp.source) {
      this.bind(0, gl.TEXTURE_2D, nearness);
      this.bind(1, gl.TEXTURE_2D, picture);
      surface({ u_origin: [piece.left, piece.top], u_least: piece.least, u_by_cells: false });
      gl.bindVertexArray(whole);
      gl.drawElements(gl.TRIANGLES, piece.whole.length, gl.UNSIGNED_INT, 0);
      surface({ u_by_cells: true });
      gl.bindVertexArray(torn);
      gl.drawArraysInstanced(gl.TRIANGLES, 0, 30, piece.torn.length / 2);
    }
  }

  drawView(warps, mode, holes, leads) {
    const { gl, scene } = this, lines = mode === "lines", fills = holes === "filled" || holes === "closed";
    const view = fills ? this.view : this.bare;
    this.bind(0, gl.TEXTURE_2D_ARRAY, this.layers.colour);
    this.bind(1, gl.TEXTURE_2D_ARRAY, this.layers.depth);
    this.bind(2, gl.TEXTURE_2D, this.palette);
    const farthest = holes === "closed" ? Math.ceil(Renderer.CLOSED_PX * this.scale) : gl.canvas.width + gl.canvas.height;
    view({
      u_colour: 0, u_depth: 1, u_palette: 2, u_count: warps.length,
      u_back: warps.flatMap(({ back }) => back),
      u_shift: warps.flatMap(({ shift }) => shift),
      u_weight: warps.map(({ weight }, index) => (lines ? Number(index === 0) + 1e-6 : weight)),
      u_epipole: warps[0].shift,
      u_scale: this.scale, u_stripe_px: 8 * this.scale, u_reach: this.reach,
      u_range: [scene.lowest - scene.infinity, scene.highest - scene.infinity],
      u_show_depth: mode === "depth", u_fill: fills, u_open: holes === "closed" || holes === "open",
      u_farthest: farthest, u_leads: leads,
    });
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Wait until all is drawn.
  async finish() {
    const { gl } = this, sync = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    while (!gl.isContextLost() && gl.getSyncParameter(sync, gl.SYNC_STATUS) !== gl.SIGNALED) {
      await new Promise((done) => setTimeout(done, 2));
    }
    gl.deleteSync(sync);
  }

  bind(unit, kind, texture) {
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(kind, texture);
  }
}
