// Shared by pages that draw a scene: data, messages, graphics, times of drawing, pointers, choices, help, saving.
const Stage = (() => {
  "use strict";
  const SLOW_MS = 70, NUM_TIMED = 3, REST_MS = 250;
  const root = document.documentElement, element = (id) => document.getElementById(id);
  const canvas = element("view"), message = element("message"), help = element("help");
  const [data, shaders] = ["scene", "shaders"].map((id) => JSON.parse(element(id).textContent));
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

  // --- times of drawing; slow drawing is coarse while something moves

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

  // --- pointers: a drag is in parts of the shorter side, two fingers that part give a logarithm

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

  // --- choices by keys: a radio button or a check box, or the next one of several

  const chosen = (ids) => ids.find((id) => element(id).checked);
  const choose = (id) => {
    const input = element(id);
    if (input.disabled) return;
    input.checked = input.type === "radio" || !input.checked;
    input.dispatchEvent(new Event("change"));
  };
  const chooseNext = (ids) => {
    const open = ids.filter((id) => !element(id).disabled);
    if (open.length) choose(open[(open.indexOf(chosen(ids)) + 1) % open.length]);
  };

  // Save the picture that paint() makes.
  const onSave = (paint, name) => element("save").addEventListener("click", () => {
    if (!painter) return;
    paint();
    canvas.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = name();
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    }, "image/png");
    draw();
  });

  // --- start: unpack() brings the data once, made(gl) returns a painter, or null after a message

  const start = (made, hasDepth) => {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: hasDepth, powerPreference: "high-performance" });
    if (!gl) {
      fail("This browser does not offer WebGL 2 here (too old, or turned off), which drawing needs. Below is only the first picture.");
      return;
    }
    painter = made(gl);
    if (!painter) return;
    message.hidden = true;
    root.classList.remove("failed");
    draw();
  };
  const begin = async ({ unpack, made, hasDepth = false }) => {
    const needs = { "WebGL 2": "WebGL2RenderingContext", DecompressionStream: "DecompressionStream", createImageBitmap: "createImageBitmap" };
    const names = Object.keys(needs).filter((name) => typeof window[needs[name]] === "undefined");
    if (names.length) {
      fail(`This browser lacks ${names.join(" and ")}, which drawing needs. Below is only the first picture.`);
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

  return { element, canvas, data, shaders, fail, draw, move, onDrag, onWheel, onKey, chosen, choose, chooseNext, onSave, begin };
})();
