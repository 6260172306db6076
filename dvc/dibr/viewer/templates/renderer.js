// Draws a scene by WebGL 2: sources into layers of a texture, then what they show together.
class Renderer {
  static MAX_SOURCES = 4;

  constructor(gl, scene, shaders) {
    Object.assign(this, { gl, scene, scale: 0 });
    this.reach = 4 * (scene.highest - scene.infinity);
    this.surface = this.program(shaders["surface.vert"], shaders["surface.frag"]);
    this.view = this.program(shaders["view.vert"], shaders["view.frag"]);
    this.palette = this.texture(gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, scene.palette);
    this.nothing = gl.createVertexArray();
    gl.vertexAttribI4i(0, 0, 0, 0, 0);  // of meshes, which have no cells: its kind must fit
    this.sources = scene.sources.map(({ pieces }) => pieces.map((piece) => this.uploaded(piece)));
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
    const positions = new Map();
    const at = (name) => {
      if (!positions.has(name)) positions.set(name, gl.getUniformLocation(program, name));
      return positions.get(name);
    };
    return { program, at };
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

  uploaded(piece) {
    const { gl } = this;
    const nearness = this.texture(gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, piece.width, piece.height, 0, gl.RED, gl.FLOAT, piece.values);
    const picture = this.texture(gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE, piece.picture);
    const whole = gl.createVertexArray();
    gl.bindVertexArray(whole);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, piece.whole, gl.STATIC_DRAW);
    const torn = gl.createVertexArray();
    gl.bindVertexArray(torn);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, piece.torn, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 2, gl.INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.bindVertexArray(null);
    return { piece, nearness, picture, whole, torn };
  }

  // Texels of a pixel of the view, and layers for that many sources.
  resize(scale) {
    const { gl, scene } = this;
    if (scale === this.scale) return;
    this.scale = scale;
    const width = scene.width * scale, height = scene.height * scale;
    Object.assign(gl.canvas, { width, height });
    const count = Math.min(this.sources.length, Renderer.MAX_SOURCES);
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

  // mode: "picture", "depth" or "lines"; fill: whether what no source shows continues the background; hold:
  // whether the middle of the scene stays where it is.
  draw(viewpoint, { mode, fill, hold }) {
    const warps = Warps.warpsTo(this.scene, viewpoint, hold).slice(0, Renderer.MAX_SOURCES);
    const lines = mode === "lines";
    this.gl.viewport(0, 0, this.gl.canvas.width, this.gl.canvas.height);
    warps.forEach((warp, layer) => this.drawSource(this.sources[warp.index], warp, layer, lines));
    this.drawView(warps, mode === "depth", fill, lines);
  }

  drawSource(pieces, warp, layer, lines) {
    const { gl, scene } = this, { program, at } = this.surface;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.layers.framebuffers[layer]);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.depthFunc(gl.GREATER);
    gl.clearDepth(0);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(program);
    gl.uniformMatrix3fv(at("u_turn"), true, warp.turn);
    gl.uniform3fv(at("u_shift"), warp.shift);
    gl.uniform2f(at("u_size"), scene.width, scene.height);
    gl.uniform1f(at("u_reach"), this.reach);
    gl.uniform1i(at("u_lines"), Number(lines));
    gl.uniform1i(at("u_nearness"), 0);
    gl.uniform1i(at("u_picture"), 1);
    for (const { piece, nearness, picture, whole, torn } of pieces) {
      this.bind(0, gl.TEXTURE_2D, nearness);
      this.bind(1, gl.TEXTURE_2D, picture);
      gl.uniform2f(at("u_origin"), piece.left, piece.top);
      gl.uniform1f(at("u_least"), piece.least);
      gl.uniform1i(at("u_by_cells"), 0);
      gl.bindVertexArray(whole);
      gl.drawElements(gl.TRIANGLES, piece.whole.length, gl.UNSIGNED_INT, 0);
      gl.uniform1i(at("u_by_cells"), 1);
      gl.bindVertexArray(torn);
      gl.drawArraysInstanced(gl.TRIANGLES, 0, 30, piece.torn.length / 2);
    }
  }

  drawView(warps, showDepth, fill, lines) {
    const { gl, scene } = this, { program, at } = this.view;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    gl.useProgram(program);
    this.bind(0, gl.TEXTURE_2D_ARRAY, this.layers.colour);
    this.bind(1, gl.TEXTURE_2D_ARRAY, this.layers.depth);
    this.bind(2, gl.TEXTURE_2D, this.palette);
    gl.uniform1i(at("u_colour"), 0);
    gl.uniform1i(at("u_depth"), 1);
    gl.uniform1i(at("u_palette"), 2);
    gl.uniform1i(at("u_count"), warps.length);
    gl.uniformMatrix3fv(at("u_back"), true, warps.flatMap(({ back }) => back));
    gl.uniform3fv(at("u_shift"), warps.flatMap(({ shift }) => shift));
    gl.uniform1fv(at("u_weight"), warps.map(({ weight }, index) => (lines ? Number(index === 0) + 1e-6 : weight)));
    gl.uniform3fv(at("u_epipole"), warps[0].shift);
    gl.uniform1f(at("u_scale"), this.scale);
    gl.uniform1f(at("u_stripe_px"), 8 * this.scale);
    gl.uniform1f(at("u_reach"), this.reach);
    gl.uniform2f(at("u_range"), scene.lowest - scene.infinity, scene.highest - scene.infinity);
    gl.uniform1i(at("u_show_depth"), Number(showDepth));
    gl.uniform1i(at("u_fill"), Number(fill));
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Wait until all is drawn.
  finish() {
    this.gl.readPixels(0, 0, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, new Uint8Array(4));
  }

  bind(unit, kind, texture) {
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(kind, texture);
  }
}
