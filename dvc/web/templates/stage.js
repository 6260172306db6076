// What pages that draw a scene share: messages, the graphics, when to draw, pointers, the help, saving.
const Stage = (() => {
  "use strict";
  const SLOW_MS = 70, NUM_TIMED = 3, REST_MS = 250;
  const root = document.documentElement, element = (id) => document.getElementById(id);
  const canvas = element("view"), message = element("message"), help = element("help");
  let painter = null, wanted = false, moving = 0, times = [];

  const say = (text) => {
    message.textContent = text;
    message.hidden = false;
  };
  const fail = (text) => {
    painter = null;
    root.classList.remove("ready");
    root.classList.add("failed");
    say(text);
  };
  const cannot = (error) => fail(`The scene cannot be drawn here: ${error.message.replaceAll("\0", "").trim()}.`);

  const missing = () => {
    const names = [];
    if (typeof WebGL2RenderingContext === "undefined") names.push("WebGL 2");
    if (typeof DecompressionStream === "undefined") names.push("DecompressionStream");
    if (typeof createImageBitmap === "undefined") names.push("createImageBitmap");
    return names;
  };

  // --- when to draw; where drawing is slow it is coarse while something moves

  const isSlow = () => times.length >= NUM_TIMED && Math.min(...times) > SLOW_MS;
  const frame = () => {
    wanted = false;
    if (!painter) return;
    const before = performance.now(), isCoarse = moving !== 0 && isSlow();
    painter.paint(isCoarse);
    if (moving && !isCoarse && times.length < NUM_TIMED && painter.canBeCoarse()) {
      painter.finish().then(() => times.push(performance.now() - before));
    }
    root.classList.add("ready");
  };
  const draw = () => {
    if (wanted) return;
    wanted = true;
    requestAnimationFrame(frame);
  };
  const move = () => {
    clearTimeout(moving);
    moving = setTimeout(() => {
      moving = 0;
      if (isSlow()) draw();
    }, REST_MS);
    draw();
  };

  // --- pointers: a drag is told in parts of the shorter side, two fingers that part as a logarithm

  const pointers = new Map();
  const apart = () => {
    const [a, b] = [...pointers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  };
  const onDrag = (dragged) => {
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture?.(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = pointers.get(event.pointerId);
      if (!last) return;
      const before = pointers.size > 1 ? apart() : 0;
      const box = canvas.getBoundingClientRect(), size = Math.min(box.width, box.height) * pointers.size;
      const right = (event.clientX - last.x) / size, down = (event.clientY - last.y) / size;
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      const closer = pointers.size === 2 ? 0.5 * Math.log(apart() / Math.max(before, 1)) : 0;
      dragged({ right, down, closer, event, fingers: pointers.size });
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  };
  const onWheel = (closer) => canvas.addEventListener("wheel", (event) => {
    if (event.ctrlKey) return;  // the browser's own zoom
    event.preventDefault();
    const pixels = event.deltaY * [1, 16, 400][event.deltaMode];
    closer(-Math.max(-0.2, Math.min(0.2, pixels / 1500)));
  }, { passive: false });

  // --- keys that are meant for the view, with those of the help

  const onKey = (pressed) => document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || help.open) return;
    if (document.activeElement !== canvas && document.activeElement !== document.body) return;
    if (event.key === "?") help.showModal();
    else if (pressed(event)) event.preventDefault();
  });
  element("help-button").addEventListener("click", () => help.showModal());

  const save = (name) => canvas.toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }, "image/png");

  // --- start: unpack() brings the data once, made(gl) returns what paints it or null if it has told why not

  const start = (made, hasDepth) => {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: hasDepth, powerPreference: "high-performance" });
    if (!gl) {
      fail("This browser does not offer WebGL 2 here (too old, or turned off), which drawing needs. Below is the first picture alone.");
      return;
    }
    const found = made(gl);
    if (!found) return;
    painter = found;
    message.hidden = true;
    root.classList.remove("failed");
    draw();
  };
  const begin = async ({ unpack, made, hasDepth = false }) => {
    const names = missing();
    if (names.length) {
      fail(`This browser lacks ${names.join(" and ")}, which drawing needs. Below is the first picture alone.`);
      return;
    }
    say("Unpacking the scene …");
    try {
      await unpack();
      start(made, hasDepth);
    } catch (error) {
      cannot(error);
      return;
    }
    canvas.addEventListener("webglcontextrestored", () => start(made, hasDepth));
  };
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    fail("The browser has taken the graphics away; the scene comes back as soon as it gives them again.");
  });
  window.addEventListener("resize", draw);
  window.addEventListener("error", (event) => cannot(event));

  return { element, canvas, say, fail, cannot, draw, move, onDrag, onWheel, onKey, save, begin, isDrawn: () => painter !== null };
})();
