// Matrices of nine numbers, row by row, and cameras made of them.
const Matrices = (() => {
  "use strict";
  const times = (a, b) => a.map((_, k) => {
    const row = 3 * Math.floor(k / 3), column = k % 3;
    return a[row] * b[column] + a[row + 1] * b[column + 3] + a[row + 2] * b[column + 6];
  });
  const apply = (a, v) => [0, 3, 6].map((row) => a[row] * v[0] + a[row + 1] * v[1] + a[row + 2] * v[2]);
  const transposed = (a) => [a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]];
  const inverse = (a) => {
    const [p, q, r, s, t, u, v, w, x] = a;
    const adjugate = [t * x - u * w, r * w - q * x, q * u - r * t, u * v - s * x, p * x - r * v, r * s - p * u,
      s * w - t * v, q * v - p * w, p * t - q * s];
    const determinant = p * adjugate[0] + q * adjugate[3] + r * adjugate[6];
    return adjugate.map((value) => value / determinant);
  };
  const minus = (a, b) => a.map((value, k) => value - b[k]);

  // [turn | shift] takes pixels of one calibrated camera, with their inverse depth, to those of another.
  const between = (source, view) => {
    const seen = times(view.intrinsic, view.rotation), way = minus(source.centre, view.centre);
    const turn = times(seen, times(transposed(source.rotation), inverse(source.intrinsic)));
    return { turn, shift: apply(seen, way), distance: Math.hypot(...way) };
  };

  return { times, apply, transposed, inverse, minus, between };
})();
