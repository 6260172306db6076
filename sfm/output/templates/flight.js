// The page of a map: the viewpoint, and the parts of the scene that are drawn.
(() => {
  "use strict";
  const { element, canvas, data, shaders, draw, choose } = Stage;
  const SHOWN = ["points", "surfaces", "both"];
  const CLOSEST = 50, MAX_TEXELS = 4e6, COARSE = 0.5, NUM_PYRAMIDS = 12;
  const UNDER = 0.92, UNDER_ALL = 0.05;  // points next to images with depth: unless these are nearly as near
  const PATH = [255, 176, 64], CAMERAS = [110, 150, 190], HERE = [255, 255, 255];
  const size = { width: data.width, height: data.height };
  let gl = null, shown = null, film = null, wish = "both";
  const made = new Map();  // drawable parts of each piece

  const isRiding = () => element("ride").checked;
  const mode = () => Stage.chosen(SHOWN);

  // --- pieces

  const thinned = (items, most) => {
    const step = Math.max(1, Math.ceil(items.length / most));
    return items.filter((_, k) => k % step === 0);
  };

  const build = (piece, cloud) => {
    const { overview, rotations, centres, intrinsic } = piece;
    const highest = Math.max(1 / overview.depth, ...piece.sources.map((source) => source.nearest));
    const scene = { palette: Decoding.bytesOf(data.palette), lowest: 0, highest, infinity: 0 };
    const renderer = new Renderer(gl, scene, shaders, CLOSEST), overlay = new Overlay(gl, renderer, shaders);
    const cameras = centres.map((centre, k) => ({ intrinsic, rotation: rotations[k], centre }));
    const length = 0.1 * overview.radius;
    const surfaces = { infinity: 0, step: 0, ratio: data.ratio };
    const unit = length / Math.max(size.width / intrinsic[0], size.height / intrinsic[4]);
    return {
      piece, renderer, overlay, unit,
      points: overlay.upload(cloud.positions, cloud.colours),
      path: overlay.lines(centres, PATH),
      pyramids: overlay.pyramids(thinned(cameras, NUM_PYRAMIDS), size, unit / 3, CAMERAS),
      sources: new Sources(renderer, piece.sources, surfaces, overview.depth, draw),
    };
  };

  const load = (index) => {
    const piece = data.pieces[index];
    if (!made.has(index)) made.set(index, build(piece, clouds[index]));
    shown = { ...made.get(index), orbit: new Orbit(piece.overview) };
    const hasPoints = piece.cloud.count > 0, hasSources = piece.sources.length > 0;
    element("points").disabled = !hasPoints;
    element("surfaces").disabled = !hasSources;
    element("both").disabled = !(hasPoints && hasSources);
    element(element(wish).disabled ? (hasSources ? "surfaces" : "points") : wish).checked = true;
    overlook();
    film.load(piece);
  };

  // --- the view

  const overlook = () => {
    const { orbit, piece: { overview, intrinsic } } = shown;
    const wide = Math.min(size.width / intrinsic[0], size.height / intrinsic[4]) / 2;
    orbit.look(overview.middle, overview.radius / wide, -0.45, 0.4);
    element("free").checked = true;
    Stage.move();
  };

  // Width and height of the canvas in texels.
  const texels = (isCoarse) => {
    const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const most = Math.sqrt(MAX_TEXELS / Math.max(1, box.width * box.height));
    const fine = Math.min(ratio, most) * (isCoarse ? COARSE : 1);
    return [Math.max(1, Math.round(box.width * fine)), Math.max(1, Math.round(box.height * fine))];
  };

  // The camera of the view: that of the frame in the middle of it, or the free one.
  const view = (width, height, scale) => {
    const intrinsic = shown.piece.intrinsic.slice();
    intrinsic[2] += (width / scale - size.width) / 2;
    intrinsic[5] += (height / scale - size.height) / 2;
    return isRiding() ? { ...film.camera, intrinsic } : shown.orbit.camera(intrinsic);
  };

  // Coarse drawing takes only the nearest picture, with its gaps.
  const paint = (width, height, isCoarse = false) => {
    const { renderer, overlay, sources, piece } = shown, scale = Math.min(width / size.width, height / size.height);
    renderer.resize(width, height, scale, Renderer.MAX_SOURCES);
    const camera = view(width, height, scale), wanted = mode();
    const warps = wanted === "points" ? [] : sources.warps(camera).slice(0, isCoarse ? 1 : Renderer.MAX_SOURCES);
    const leads = warps.length > 0 && warps[0].away < Sources.SAME;
    renderer.draw(warps, { mode: "picture", holes: isCoarse ? "open" : "closed", leads, tests: true });
    if (wanted !== "surfaces") {
      const diameter = 2 * piece.cloud.spacing * camera.intrinsic[0] * scale;
      const behind = wanted === "points" ? 1 : isRiding() ? UNDER_ALL : UNDER;
      overlay.draw(camera, shown.points, gl.POINTS, { diameter, sizes: [2, 6 * scale], behind });
    }
    if (element("path").checked && !isRiding()) paintPath(camera);
    const isSettled = !isCoarse && (wanted === "points" || sources.isComplete) && !film.isPending;
    document.documentElement.classList.toggle("settled", isSettled);
  };

  const paintPath = (camera) => {
    const { overlay, unit } = shown, here = film.camera;
    overlay.draw(camera, shown.path, gl.LINE_STRIP, {});
    overlay.draw(camera, shown.path, gl.POINTS, { diameter: 0, sizes: [3, 3] });
    overlay.draw(camera, shown.pyramids, gl.LINES, {});
    const own = overlay.pyramids([here], size, unit, HERE);
    overlay.draw(camera, own, gl.LINES, {});
    overlay.release(own);
    if (overlay.picture) overlay.drawPicture(camera, Overlay.corners(here, size, unit));
  };

  // --- moving

  // The free view starts from the visible one.
  const release = () => {
    if (!isRiding()) return;
    shown.orbit.follow(film.camera, shown.piece.overview.depth);
    element("free").checked = true;
  };
  const moved = (change) => {
    if (!shown) return;
    release();
    change(shown.orbit);
    Stage.move();
  };
  const closer = (factor) => moved((orbit) => orbit.closer(factor, 1e-3 * shown.piece.overview.radius));

  Stage.onDrag(({ right, down, closer: factor, event, fingers }) => moved((orbit) => {
    const isSideways = fingers > 1 || event.shiftKey || (event.buttons & 6) !== 0;
    if (isSideways) orbit.shift(-right, -down);
    else orbit.turn(3 * right, 3 * down);
    if (factor) closer(factor);
  }));
  Stage.onWheel((factor) => closer(2 * factor));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => shown && overlook());

  const TURN = 0.06, SHIFT = 0.04;
  const turned = (right, down) => (event) => moved((orbit) =>
    (event.shiftKey ? orbit.shift(SHIFT * right, SHIFT * down) : orbit.turn(TURN * right, TURN * down)));
  const keys = {
    ArrowLeft: turned(-1, 0), ArrowRight: turned(1, 0), ArrowUp: turned(0, -1), ArrowDown: turned(0, 1),
    "+": () => closer(0.1), "=": () => closer(0.1), "-": () => closer(-0.1), PageUp: () => closer(0.1), PageDown: () => closer(-0.1),
    Home: () => overlook(), "0": () => overlook(), " ": () => film.toggle(), v: () => Stage.chooseNext(SHOWN),
    ",": () => film.go(film.index - 1), ".": () => film.go(film.index + 1),
    c: () => choose(isRiding() ? "free" : "ride"), p: () => choose("path"), i: () => choose("frames"),
  };
  Stage.onKey((event) => {
    if (shown) keys[event.key]?.(event);
    return Boolean(shown && keys[event.key]);
  });

  ["free", "ride", "path", ...SHOWN].forEach((id) => element(id).addEventListener("change", draw));
  SHOWN.forEach((id) => element(id).addEventListener("change", () => { wish = id; }));
  element("frames").addEventListener("change", () => { element("inset").hidden = !element("frames").checked; });
  element("piece")?.addEventListener("change", (event) => load(Number(event.target.value)));
  element("reset").addEventListener("click", () => shown && overlook());
  Stage.onSave(
    () => (isRiding() ? paint(size.width, size.height) : paint(...texels(false))),
    () => `${data.name}-${film.piece.frames[film.index]}.png`,
  );

  // --- start

  let clouds = [];
  const start = (context) => {
    const before = shown ? film.index : 0;
    gl = context;
    made.clear();
    film ??= new Film(data, draw, (image) => {
      shown.overlay.show(image);
      draw();
    });
    load(Number(element("piece")?.value ?? 0));
    film.address = null;  // its picture is wanted again
    film.go(before);
    return {
      paint: (isCoarse) => paint(...texels(isCoarse), isCoarse),
      canBeCoarse: () => true,
      finish: () => shown.renderer.finish(),
    };
  };
  if (data.pieces.length === 0) {
    Stage.fail("No frame of this sequence could be located: there is no map to show.");
    return;
  }
  Stage.begin({
    unpack: async () => { clouds = await Promise.all(data.pieces.map(({ cloud }) => Overlay.cloud(cloud))); },
    made: start,
    hasDepth: true,
  });
})();
