// The page: what is missing, controls, and when to draw.
(() => {
  "use strict";
  document.documentElement.classList.add("js");
  const element = (id) => document.getElementById(id);
  const canvas = element("view"), still = element("still"), message = element("message"), told = element("told");
  const data = JSON.parse(element("scene").textContent), shaders = JSON.parse(element("shaders").textContent);
  const { bounds } = data;
  const START = { m: data.views[0].m, n: data.views[0].n, closer: 0 };
  const LIMITS = { m: [bounds.left, bounds.right], n: [bounds.top, bounds.bottom], closer: [-0.5, 0.5] };
  const MODES = ["picture", "depth", "lines"];
  const MAX_SCALE = 3, MAX_TEXELS = 6e6, SLOW_MS = 70, NUM_TIMED = 3;
  const at = { ...START };
  let renderer = null, scene = null, wanted = false, moving = 0, times = [];

  const say = (text) => {
    message.textContent = text;
    message.hidden = false;
  };
  const fail = (text) => {
    renderer = null;
    document.documentElement.classList.remove("ready");
    document.documentElement.classList.add("failed");
    say(text);
  };

  const missing = () => {
    const names = [];
    if (typeof WebGL2RenderingContext === "undefined") names.push("WebGL 2");
    if (typeof DecompressionStream === "undefined") names.push("DecompressionStream");
    if (typeof createImageBitmap === "undefined") names.push("createImageBitmap");
    return names;
  };
  const context = () => canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });

  // --- what is shown

  const options = () => ({
    mode: MODES.find((mode) => element(mode).checked),
    fill: !element("mark").checked,
    hold: element("hold").checked,
  });

  const fineScale = () => {
    const shown = canvas.getBoundingClientRect().width * (window.devicePixelRatio || 1);
    const most = Math.floor(Math.sqrt(MAX_TEXELS / (data.width * data.height)));
    return Math.max(1, Math.min(MAX_SCALE, most, Math.ceil(shown / data.width - 0.25)));
  };

  const paint = (scale) => {
    renderer.resize(scale);
    renderer.draw(at, options());
  };

  const frame = () => {
    wanted = false;
    if (!renderer) return;
    const before = performance.now(), fine = fineScale();
    paint(moving && isSlow() ? 1 : fine);
    if (moving && fine > 1 && times.length < NUM_TIMED) {
      renderer.finish();
      times.push(performance.now() - before);
    }
    document.documentElement.classList.add("ready");
  };
  const draw = () => {
    if (wanted) return;
    wanted = true;
    requestAnimationFrame(frame);
  };
  // Where drawing is slow it is coarse while the viewpoint moves.
  const isSlow = () => times.length === NUM_TIMED && Math.min(...times) > SLOW_MS;
  const rest = () => {
    clearTimeout(moving);
    moving = setTimeout(() => {
      moving = 0;
      if (isSlow()) draw();
    }, 250);
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
    if (announce) told.textContent = `Viewpoint ${number(at.m)}, ${number(at.n)}, closer ${number(at.closer)}`;
    rest();
    draw();
  };
  const by = (m, n, closer = 0) => ({ m: at.m + m, n: at.n + n, closer: at.closer + closer });
  const span = (name) => LIMITS[name][1] - LIMITS[name][0];

  // --- pointers: one moves sideways, two that part come closer

  const pointers = new Map();
  const apart = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture?.(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const before = pointers.size > 1 ? apart() : 0;
    const box = canvas.getBoundingClientRect(), size = Math.min(box.width, box.height);
    const dx = (event.clientX - last.x) / (size * pointers.size), dy = (event.clientY - last.y) / (size * pointers.size);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    const closer = pointers.size === 2 ? 0.5 * Math.log(apart() / Math.max(before, 1)) : 0;
    const whole = Math.max(span("m"), span("n"));
    move(by(-whole * dx, -whole * dy, closer));
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    if (event.ctrlKey) return;  // the browser's own zoom
    event.preventDefault();
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
    move(by(0, 0, -Math.max(-0.2, Math.min(0.2, pixels / 1500))));
  }, { passive: false });
  canvas.addEventListener("dblclick", () => move(START, true));

  // --- keys

  const help = element("help");
  const choose = (id) => {
    const input = element(id);
    input.checked = input.type === "radio" || !input.checked;
    draw();
  };
  const keys = {
    ArrowLeft: (part) => by(-part * span("m"), 0), ArrowRight: (part) => by(part * span("m"), 0),
    ArrowUp: (part) => by(0, -part * span("n")), ArrowDown: (part) => by(0, part * span("n")),
    "+": () => by(0, 0, 0.05), "=": () => by(0, 0, 0.05), "-": () => by(0, 0, -0.05),
    PageUp: () => by(0, 0, 0.05), PageDown: () => by(0, 0, -0.05), Home: () => START, "0": () => START,
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || help.open) return;
    if (document.activeElement !== canvas && document.activeElement !== document.body) return;
    const change = keys[event.key]?.(event.shiftKey ? 0.1 : 0.025);
    if (change) {
      event.preventDefault();
      move(change, true);
    } else if (event.key === "v") {
      choose(MODES[(MODES.findIndex((mode) => element(mode).checked) + 1) % MODES.length]);
    } else if (event.key === "u") {
      choose("mark");
    } else if (event.key === "h") {
      choose("hold");
    } else if (event.key === "?") {
      help.showModal();
    }
  });

  // --- buttons

  MODES.concat("mark", "hold").forEach((id) => element(id).addEventListener("change", draw));
  element("reset").addEventListener("click", () => move(START, true));
  element("help-button").addEventListener("click", () => help.showModal());
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
  element("save").addEventListener("click", () => {
    if (!renderer) return;
    paint(1);
    canvas.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = `${data.name}-${at.m.toFixed(2)}-${at.n.toFixed(2)}.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    }, "image/png");
    draw();
  });
  window.addEventListener("resize", draw);
  window.addEventListener("error", ({ message: text }) => fail(`The scene cannot be drawn here: ${text}.`));

  // --- start

  const start = () => {
    const gl = context();
    if (!gl) {
      fail("This browser does not offer WebGL 2 here (too old, or turned off), which drawing needs. Below is the first picture alone.");
      return;
    }
    const side = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    const largest = Math.max(data.width, data.height, ...scene.sources.flatMap(({ pieces }) => pieces.flatMap((one) => [one.width, one.height])));
    if (largest > side) {
      fail(`Pictures of this scene have ${largest} pixels in a row, the graphics here at most ${side}.`);
      return;
    }
    renderer = new Renderer(gl, scene, shaders);
    message.hidden = true;
    document.documentElement.classList.remove("failed");
    readout();
    draw();
  };
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    fail("The browser has taken the graphics away; the scene comes back as soon as it gives them again.");
  });
  canvas.addEventListener("webglcontextrestored", () => start());

  const begin = async () => {
    const names = missing();
    if (names.length) {
      fail(`This browser lacks ${names.join(" and ")}, which drawing needs. Below is the first picture alone.`);
      return;
    }
    try {
      scene = await Decoding.scene(data, still);
      start();
    } catch (error) {
      fail(`The scene cannot be drawn here: ${error.message.replaceAll("\0", "").trim()}.`);
    }
  };
  say("Unpacking the scene …");
  begin();
})();
