// Data of the page as arrays and pictures.
const Decoding = (() => {
  "use strict";
  const bytesOf = (text) => {
    const characters = atob(text), bytes = new Uint8Array(characters.length);
    for (let k = 0; k < bytes.length; k++) bytes[k] = characters.charCodeAt(k);
    return bytes;
  };

  const inflated = async (bytes) => {
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };

  // Disparity above that of infinity of each pixel, -1 without a surface.
  const nearness = async (piece, infinity) => {
    const { width, height, lowest, unit } = piece, count = width * height;
    const bytes = await inflated(bytesOf(piece.codes)), values = new Float32Array(count);
    for (let row = 0; row < height; row++) {
      for (let column = 0, code = 0; column < width; column++) {
        const position = row * width + column;
        code = (code + 256 * bytes[position] + bytes[count + position]) & 0xffff;
        values[position] = code === 0 ? -1 : Math.max(lowest - infinity + (code - 1) * unit, 0);
      }
    }
    return values;
  };

  const AS_IT_IS = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
  const picture = async (piece, still) => {
    if (piece.picture !== null) {
      return createImageBitmap(new Blob([bytesOf(piece.picture)], { type: "image/webp" }), AS_IT_IS);
    }
    await still.decode();
    return createImageBitmap(still, AS_IT_IS);
  };

  // Cells of four pixels of one surface as triangles of a mesh; cells that may be torn, by their corner.
  // Values of one surface differ by one and a half steps at most, or by no more than a ratio.
  const mesh = (values, width, height, { step, ratio = 1 }) => {
    const whole = new Uint32Array(6 * width * height), torn = [];
    let end = 0;
    const at = (row, column) => (row < 0 || column < 0 || row >= height || column >= width ? -1 : values[row * width + column]);
    for (let row = -1; row < height; row++) {
      let a = -1, c = -1;  // the corners on the left, above and below
      for (let column = -1; column < width; column++) {
        const b = at(row, column + 1), d = at(row + 1, column + 1);
        const most = Math.max(a, b, c, d), least = Math.min(a, b, c, d);
        if (least >= 0 && (most - least <= 1.5 * step || most < ratio * least)) {
          const first = row * width + column, below = first + width;
          for (const vertex of [first, first + 1, below, below + 1, below, first + 1]) whole[end++] = vertex;
        } else if (most >= 0) {
          torn.push(column, row);
        }
        [a, c] = [b, d];
      }
    }
    return { whole: whole.slice(0, end), torn: Int32Array.from(torn) };
  };

  const source = async (data, scene, still) => ({
    position: data.position,
    camera: data.camera,
    pieces: await Promise.all(data.pieces.map(async (piece) => {
      const values = await nearness(piece, scene.infinity);
      return {
        left: piece.left, top: piece.top, width: piece.width, height: piece.height, values,
        least: values.reduce((least, value) => (value >= 0 && value < least ? value : least), Infinity),
        picture: await picture(piece, still),
        ...mesh(values, piece.width, piece.height, scene),
      };
    })),
  });

  const scene = async (data, still) => {
    const sources = await Promise.all(data.sources.map((each) => source(each, data, still)));
    let sum = 0, count = 0;  // for the mean nearness of the first source
    for (const { values } of sources[0].pieces) {
      for (const value of values) {
        sum += Math.max(value, 0);
        count += Number(value >= 0);
      }
    }
    return { ...data, palette: bytesOf(data.palette), sources, middle: count ? sum / count : 0 };
  };

  return { scene, source, bytesOf, inflated };
})();
