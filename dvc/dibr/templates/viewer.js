// The page of a scene: its controls, and the viewpoint that they move.
(() => {
  "use strict";
  const { element, canvas, data, shaders, draw, choose } = Stage, { bounds } = data;
  const START = { m: data.views[0].m, n: data.views[0].n, closer: 0 };
  const LIMITS = { m: [bounds.left, bounds.right], n: [bounds.top, bounds.bottom], closer: [-0.5, 0.5] };
  const MODES = ["picture", "depth", "lines"];
  const MAX_SCALE = 3, MAX_TEXELS = 6e6;
  const at = { ...START };
  let renderer = null, scene = null, sources = [];

  // --- drawing

  const fineScale = () => {
    const shown = canvas.getBoundingClientRect().width * (window.devicePixelRatio || 1);
    const most = Math.floor(Math.sqrt(MAX_TEXELS / (data.width * data.height)));
    return Math.max(1, Math.min(MAX_SCALE, most, Math.ceil(shown / data.width - 0.25)));
  };

  const paint = (scale) => {
    const count = Math.min(sources.length, Renderer.MAX_SOURCES);
    renderer.resize(data.width * scale, data.height * scale, scale, count);
    const warps = Warps.warpsTo(scene, at, element("hold").checked).slice(0, count);
    renderer.draw(warps.map((warp) => ({ ...warp, source: sources[warp.index] })), {
      mode: Stage.chosen(MODES),
      holes: element("mark").checked ? "marked" : "filled",
    });
  };

  // --- the viewpoint

  const number = (value) => (Math.abs(value) < 5e-4 ? 0 : value).toFixed(2).replace("-", "\u2212");
  const here = () => data.views.findIndex((view) => Math.hypot(view.m - at.m, view.n - at.n) < 1e-3 && at.closer === 0);
  const readout = () => {
    for (const name of Object.keys(LIMITS)) {
      const input = element(`at-${name}`);
      if (document.activeElement !== input) input.value = String(Number(at[name].toFixed(3)));
    }
    const view = here();
    document.querySelectorAll("[data-view]").forEach((button) =>
      button.setAttribute("aria-pressed", String(Number(button.dataset.view) === view)));
    const quality = view < 0 ? null : data.views[view].psnr_db;
    element("quality").textContent = quality === null ? "" : `PSNR ${quality.toFixed(2)} dB here`;
  };
  const move = (change, announce = false) => {
    for (const [name, value] of Object.entries(change)) {
      const [low, high] = LIMITS[name];
      at[name] = Math.min(Math.max(value, low), high);
    }
    readout();
    if (announce) element("told").textContent = `Viewpoint ${number(at.m)}, ${number(at.n)}, closer ${number(at.closer)}`;
    Stage.move();
  };
  const by = (m, n, closer = 0) => ({ m: at.m + m, n: at.n + n, closer: at.closer + closer });
  const span = (name) => LIMITS[name][1] - LIMITS[name][0];

  Stage.onDrag(({ right, down, closer }) => {
    const whole = Math.max(span("m"), span("n"));
    move(by(-whole * right, -whole * down, closer));
  });
  Stage.onWheel((closer) => move(by(0, 0, closer)));
  canvas.addEventListener("dblclick", () => move(START, true));

  // --- keys

  const keys = {
    ArrowLeft: (part) => by(-part * span("m"), 0), ArrowRight: (part) => by(part * span("m"), 0),
    ArrowUp: (part) => by(0, -part * span("n")), ArrowDown: (part) => by(0, part * span("n")),
    "+": () => by(0, 0, 0.05), "=": () => by(0, 0, 0.05), "-": () => by(0, 0, -0.05),
    PageUp: () => by(0, 0, 0.05), PageDown: () => by(0, 0, -0.05), Home: () => START, "0": () => START,
  };
  const switches = { v: () => Stage.chooseNext(MODES), u: () => choose("mark"), h: () => choose("hold") };
  Stage.onKey(({ key, shiftKey }) => {
    const change = keys[key]?.(shiftKey ? 0.1 : 0.025);
    if (change) move(change, true);
    else switches[key]?.();
    return Boolean(change);
  });

  // --- buttons

  MODES.concat("mark", "hold").forEach((id) => element(id).addEventListener("change", draw));
  element("reset").addEventListener("click", () => move(START, true));
  document.querySelectorAll("[data-view]").forEach((button) => button.addEventListener("click", () => {
    const { m, n } = data.views[Number(button.dataset.view)];
    move({ m, n, closer: 0 }, true);
  }));
  for (const [name, [low, high]] of Object.entries(LIMITS)) {
    const input = element(`at-${name}`);
    Object.assign(input, { min: low, max: high, step: "any" });
    input.addEventListener("change", () => {
      if (Number.isFinite(input.valueAsNumber)) move({ [name]: input.valueAsNumber }, true);
      input.value = String(Number(at[name].toFixed(3)));
    });
  }
  Stage.onSave(() => paint(1), () => `${data.name}-${at.m.toFixed(2)}-${at.n.toFixed(2)}.png`);

  // --- start

  const made = (gl) => {
    const side = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    const largest = Math.max(data.width, data.height, ...scene.sources.flatMap(({ pieces }) => pieces.flatMap((one) => [one.width, one.height])));
    if (largest > side) {
      Stage.fail(`Pictures of this scene have ${largest} pixels in a row, the graphics here at most ${side}.`);
      return null;
    }
    renderer = new Renderer(gl, scene, shaders);
    sources = scene.sources.map(({ pieces }) => renderer.upload(pieces));
    readout();
    return {
      paint: (isCoarse) => paint(isCoarse ? 1 : fineScale()),
      canBeCoarse: () => fineScale() > 1,
      finish: () => renderer.finish(),
    };
  };
  Stage.begin({ unpack: async () => { scene = await Decoding.scene(data, element("still")); }, made });
})();
