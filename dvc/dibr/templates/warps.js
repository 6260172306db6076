// Where pixels of a source lie in the view that is looked at: as in dvc.geometry.viewpoints.
const Warps = (() => {
  "use strict";
  const { times, apply, transposed, inverse, minus, between } = Matrices;
  const NEAR_VIEW = 1e-3;
  const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1];

  // The rotation nearest to a matrix, by Newton's iteration for its polar decomposition.
  const orthonormal = (matrix) => {
    let found = matrix;
    for (let k = 0; k < 30; k++) {
      const other = transposed(inverse(found));
      found = found.map((value, index) => 0.5 * (value + other[index]));
    }
    return found;
  };

  // A camera at (m, n) among calibrated ones: at each of them it is that one, between them a mean of all.
  const cameraAt = (cameras, m, n) => {
    const away = cameras.views.map(({ position }) => (position[0] - m) ** 2 + (position[1] - n) ** 2);
    const there = away.findIndex((value) => value < 1e-12);
    const weights = away.map((value, k) => (there < 0 ? 1 / value : Number(k === there)));
    const total = weights.reduce((sum, weight) => sum + weight, 0);
    const mean = (values) => values[0].map((_, k) =>
      values.reduce((sum, value, view) => sum + weights[view] / total * value[k], 0));
    if (there >= 0) return cameras.views[there];
    const forward = mean(cameras.views.map(({ position }) => [position[2]]))[0];
    const offset = apply(transposed(cameras.axes), [m, n, forward]);
    return {
      intrinsic: mean(cameras.views.map(({ intrinsic }) => intrinsic)),
      rotation: orthonormal(mean(cameras.views.map(({ rotation }) => rotation))),
      centre: cameras.origin.map((value, k) => value + offset[k]),
    };
  };

  // The same view, moved so that the middle of the scene stays in the middle of it.
  const held = (warps, scene) => {
    const { turn, shift } = warps[0], middle = [(scene.width - 1) / 2, (scene.height - 1) / 2, 1];
    const there = apply(turn, middle).map((value, k) => value + scene.middle * shift[k]);
    const [right, down] = [0, 1].map((k) => middle[k] - there[k] / there[2]);
    const moved = (matrix) => times([1, 0, right, 0, 1, down, 0, 0, 1], matrix);
    return warps.map((warp) => {
      const turned = moved(warp.turn);
      const [x, y, w] = warp.shift;
      return { ...warp, turn: turned, shift: [x + right * w, y + down * w, w], back: inverse(turned) };
    });
  };

  // [turn | shift] from each source to a viewpoint, for nearness (disparity above infinity's); and weights.
  const warpsTo = (scene, { m, n, closer }, hold = false) => {
    const camera = scene.cameras && cameraAt(scene.cameras, m, n);
    const centre = camera ? [2, 5, 8].map((k) => camera.intrinsic[k])
      : [(scene.width - 1) / 2, (scene.height - 1) / 2, 1];
    const rate = closer / (scene.highest - scene.infinity);
    let all = scene.sources.map((source, index) => {
      let turn, shift, distance;
      if (camera) {
        ({ turn, shift, distance } = between(source.camera, camera));
      } else {
        const way = [source.position[0] - m, source.position[1] - n];
        turn = IDENTITY.slice();
        shift = [...way, 0];
        distance = Math.hypot(...way);
      }
      turn = turn.map((value, k) => value + (k % 3 === 2 ? scene.infinity * shift[Math.floor(k / 3)] : 0));
      shift = minus(shift, centre.map((value) => rate * value));
      return { index, turn, shift, back: inverse(turn), distance };
    });
    if (hold) all = held(all, scene);
    const near = NEAR_VIEW * Math.max(...all.map(({ distance }) => distance), 1e-9);
    all.forEach((warp) => { warp.weight = near / (warp.distance + near); });
    return all.sort((a, b) => b.weight - a.weight);
  };

  return { warpsTo, cameraAt };
})();
