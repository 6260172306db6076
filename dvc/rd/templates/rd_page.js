"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const drawn = new Set();
  let onPaper = false;
  const isDark = () => dark.matches && !onPaper;
  const LOSSLESS_DB = 99;
  const KEY_LETTERS = "k";
  const PAPER_WIDTH_PX = 640;

  // Plotly interprets a little HTML in every text; names of sequences and codecs are plain text.
  const plain = (text) => text.replace(/[&<>]/g, (sign) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;" })[sign]);
  const colourOf = (style) => (isDark() && style.colour === "#333333" ? "#e8eaed" : style.colour);
  const some = (selector, root = document) => Array.from(root.querySelectorAll(selector));

  function layout(x, y, extra = {}) {
    const text = isDark() ? "#e8eaed" : "#1b1f24";
    const axis = {
      gridcolor: isDark() ? "#333a42" : "#e0e3e7", zeroline: false, automargin: true, linecolor: text, ticks: "outside",
    };
    return {
      xaxis: { ...axis, title: { text: x }, ...extra.xaxis },
      yaxis: { ...axis, title: { text: y }, ...extra.yaxis },
      font: { family: "system-ui, sans-serif", size: 13, color: text },
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      margin: { l: 56, r: 12, t: extra.title ? 34 : 12, b: 46 }, height: extra.height || 440,
      width: onPaper ? PAPER_WIDTH_PX : undefined, autosize: !onPaper,
      title: extra.title ? { text: extra.title, font: { size: 14 }, x: 0.02, xanchor: "left" } : undefined,
      showlegend: Boolean(extra.legend), legend: { orientation: "h", y: -0.3, font: { size: 11 } },
      hovermode: "closest", barmode: "stack", bargap: 0.1, dragmode: "zoom",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: isDark() ? "#aeb6bf" : "#555e68" },
    };
  }

  const options = {
    responsive: true, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "toImage"],
  };

  function draw(element, traces, shape) {
    element.hidden = false;
    return Plotly.react(element, traces, shape, options);
  }

  // ---- Rate-distortion curves

  function rdTraces(curves) {
    return curves.map((curve) => {
      const style = data.styles[curve.label];
      return {
        x: curve.points.map((point) => point.rate), y: curve.points.map((point) => point.psnr),
        text: curve.points.map((point) => `${plain(curve.label)}<br>${plain(point.name)}`),
        customdata: curve.points.map((point) => (point.colour === null ? "" : `, colour ${point.colour.toFixed(2)} dB`)),
        name: plain(curve.label), mode: curve.points.length > 1 ? "lines+markers" : "markers",
        line: { color: colourOf(style), dash: style.dash, width: 2 },
        marker: { symbol: style.symbol, size: 9, color: colourOf(style), line: { width: 2, color: colourOf(style) } },
        hovertemplate: "%{text}<br>%{x:.1f} kbit/s, %{y:.2f} dB%{customdata}<extra></extra>",
      };
    });
  }

  function spread(values, low, high) {
    const least = Math.min(...values), most = Math.max(...values), room = Math.max(most - least, 0.1 * Math.abs(most), 0.5);
    return [least - low * room, most + high * room];
  }

  function ranges(curves, which, logarithmic) {
    const codecs = curves.filter((curve) => !curve.anchor && !curve.lossless);
    const shown = which === "codecs" && codecs.some((curve) => curve.points.length > 1) ? codecs : curves;
    const points = shown.flatMap((curve) => curve.points);
    let x = spread(points.map((point) => point.rate), 0.15, 0.2);
    x[0] = Math.max(x[0], 0);
    if (logarithmic) x = spread(points.map((point) => Math.log10(point.rate)), 0.06, 0.06);
    return { x, y: spread(points.map((point) => point.psnr), 0.1, 0.1) };
  }

  function drawRd(element) {
    const slug = element.dataset.rd, curves = data.sequences[slug], state = states[slug];
    const range = ranges(curves, state.range, state.log);
    const traces = rdTraces(curves);
    traces.forEach((trace, i) => { trace.visible = state.visible[i]; });
    return draw(element, traces, layout("rate [kbit/s]", "luma PSNR [dB]", {
      xaxis: { type: state.log ? "log" : "linear", range: range.x }, yaxis: { range: range.y },
    }));
  }

  const states = {};
  for (const [slug, curves] of Object.entries(data.sequences)) {
    states[slug] = { range: "codecs", log: false, visible: curves.map((curve) => !curve.lossless) };
  }

  some("[data-legend]").forEach((legend) => {
    const slug = legend.dataset.legend;
    const element = document.querySelector(`[data-rd="${CSS.escape(slug)}"]`);
    some("input", legend).forEach((box) => box.addEventListener("change", () => {
      states[slug].visible[Number(box.dataset.trace)] = box.checked;
      if (drawn.has(element)) Plotly.restyle(element, { visible: box.checked }, [Number(box.dataset.trace)]);
    }));
    const zoom = document.querySelector(`[data-zoom="${CSS.escape(slug)}"]`);
    some("button", zoom).forEach((button) => button.addEventListener("click", () => {
      states[slug].range = button.dataset.range;
      drawRd(element);
    }));
    zoom.querySelector("[data-log]").addEventListener("change", (event) => {
      states[slug].log = event.target.checked;
      drawRd(element);
    });
  });

  // ---- Frame by frame

  const isLossless = (value) => value !== null && value >= LOSSLESS_DB;

  function views(curves) {
    const found = [];
    curves.forEach((curve, i) => curve.points.forEach((point, k) => {
      if (point.frames.psnr) found.push({ group: curve.label, name: point.name, members: [[i, k]], single: true });
    }));
    const levels = new Map();
    curves.forEach((curve, i) => curve.points.forEach((point, k) => {
      if (!point.frames.initial) return;
      const level = point.lossless ? "lossless key frames" : point.level === null ? point.name : point.level;
      if (!levels.has(level)) levels.set(level, new Map());
      if (!levels.get(level).has(i)) levels.get(level).set(i, [i, k]);
    }));
    const together = [];
    for (const [level, members] of levels) {
      if (members.size > 1) together.push({ group: "Side information of all codecs", name: level, members: [...members.values()] });
    }
    return [...together, ...found];
  }

  function frameTrace(name, frames, y, style, extra = {}) {
    return {
      x: y.map((_, i) => frames.first + i), y, name: plain(name), type: "scatter", mode: "lines+markers", connectgaps: true,
      line: { color: colourOf(style), dash: style.dash, width: 1.6 }, marker: { symbol: style.symbol, size: 5, color: colourOf(style) },
      hovertemplate: "frame %{x}: %{y}<extra></extra>", ...extra,
    };
  }

  function singleTraces(curve, point) {
    const frames = point.frames, style = data.styles[curve.label];
    const soft = isDark() ? "#aeb6bf" : "#555e68";
    const traces = [frameTrace("decoded", frames, frames.psnr.map((v) => (isLossless(v) ? null : v)), style)];
    const lines = { refined: ["side information, refined", "dash"], initial: ["side information, initial", "dot"] };
    for (const [key, [name, dash]] of Object.entries(lines)) {
      if (frames[key]) traces.push(frameTrace(name, frames, frames[key], style, { mode: "lines", line: { color: soft, dash, width: 1.6 } }));
    }
    return traces;
  }

  // Predicted frames by their side information, key frames as they were decoded: the peaks.
  function peaks(frames) {
    return frames.initial.map((value, i) => {
      const key = KEY_LETTERS.includes(frames.types[i]);
      return key && frames.psnr && !isLossless(frames.psnr[i]) ? frames.psnr[i] : value;
    });
  }

  function charts(curves, view) {
    const members = view.members.map(([i, k]) => [curves[i], curves[i].points[k]]);
    const [curve, point] = members[0];
    const list = [];
    const psnr = view.single ? singleTraces(curve, point)
      : members.map(([one, at]) => frameTrace(one.label, at.frames, peaks(at.frames), data.styles[one.label]));
    list.push([view.single ? "PSNR" : "Side information; peaks: decoded key frames", "luma PSNR [dB]", psnr, true]);
    const others = { kbits: [view.single ? "Rate (grey: key frames)" : "Rate", "kbit per frame"], requests: ["Requests", "requests per frame"], decode: ["Decoding time", "s per frame"] };
    for (const [key, [title, unit]] of Object.entries(others)) {
      const traces = members.filter(([, at]) => at.frames[key]).map(([one, at]) => {
        const style = data.styles[one.label];
        if (!view.single) return frameTrace(one.label, at.frames, at.frames[key], style);
        const colours = [...at.frames.types].map((type) => (KEY_LETTERS.includes(type) ? (isDark() ? "#aeb6bf" : "#777777") : colourOf(style)));
        return frameTrace(one.label, at.frames, at.frames[key], style, { type: "bar", mode: undefined, marker: { color: colours } });
      });
      if (traces.length) list.push([title, unit, traces, false]);
    }
    return list;
  }

  function drawFrames(element) {
    const slug = element.dataset.frames, curves = data.sequences[slug];
    const select = document.querySelector(`[data-view="${CSS.escape(slug)}"]`);
    const view = views(curves)[Number(select.value)];
    if (!view) return;
    element.hidden = false;
    some("div.one", element).forEach((old) => { Plotly.purge(old); old.remove(); });
    charts(curves, view).forEach(([title, unit, traces, wide]) => {
      const part = document.createElement("div");
      part.className = wide ? "one wide" : "one";
      part.setAttribute("role", "img");
      part.setAttribute("aria-label", `${title}: ${unit}, by frame; ${view.group}, ${view.name}`);
      element.append(part);
      const legend = wide && traces.length > 1;
      draw(part, traces, layout("frame", unit, { title, height: wide ? 340 : 260, legend }));
    });
  }

  some("[data-view]").forEach((select) => {
    const slug = select.dataset.view, groups = new Map();
    const listed = views(data.sequences[slug]);
    listed.forEach((view, i) => {
      if (!groups.has(view.group)) {
        const group = document.createElement("optgroup");
        group.label = view.group;
        groups.set(view.group, group);
        select.append(group);
      }
      groups.get(view.group).append(new Option(view.name, i));
    });
    const element = document.querySelector(`[data-frames="${CSS.escape(slug)}"]`);
    const first = listed.findIndex((view) => !view.single);
    const codec = listed.filter((view) => view.group === listed[0].group);
    select.value = String(first >= 0 ? listed.indexOf(codec[Math.floor(codec.length / 2)]) : Math.floor(codec.length / 2));
    select.addEventListener("change", () => drawFrames(element));
  });

  // ---- Pictures

  some("[data-pictures]").forEach((block) => {
    const entries = data.pictures[block.dataset.pictures];
    const select = block.querySelector("select"), range = block.querySelector("input");
    const compare = block.querySelector(".compare"), noise = block.querySelector(".noise");
    const [original, decoded] = some("img", compare);
    const show = () => {
      const entry = entries[Number(select.value)];
      const what = `${entry.type ? `${entry.type} ` : ""}frame ${entry.index}`;
      for (const [image, kind, name] of [[original, "original", "original"], [decoded, "decoded", "decoded"]]) {
        image.width = entry.width;
        image.height = entry.height;
        image.src = data.sources[entry[kind]];
        image.alt = `${what}, ${name}`;
      }
      block.querySelector("figcaption").textContent = `Left original, right decoded by ${entry.label}: ${what}, counted from the first coded frame.`;
      noise.hidden = entry.noise === null;
      const picture = noise.querySelector("img");
      if (entry.noise !== null) {
        picture.width = entry.width;
        picture.height = entry.height;
        picture.src = data.sources[entry.noise];
        picture.alt = `Correlation noise of ${what}`;
      }
    };
    select.addEventListener("change", show);
    range.addEventListener("input", () => compare.style.setProperty("--split", `${range.value}%`));
    const wanted = entries.findIndex((entry) => entry.noise !== null);
    select.value = String(Math.max(wanted, 0));
    show();
  });

  // ---- Verdict

  const anchor = document.getElementById("anchor");
  if (anchor) {
    const choose = () => some(".verdict").forEach((part) => { part.hidden = part.dataset.anchor !== anchor.value; });
    anchor.addEventListener("change", () => {
      choose();
      const label = anchor.options[anchor.selectedIndex].text;
      document.getElementById("compared").textContent = `The tables compare with ${label}.`;
    });
    choose();
  }

  // ---- Rate against cost

  function drawCosts(element) {
    const traces = data.costs.map(([label, cost, rate]) => {
      const style = data.styles[label];
      return {
        x: [cost], y: [rate], name: plain(label), mode: "markers",
        marker: { symbol: style.symbol, size: 10, color: colourOf(style), line: { width: 2, color: colourOf(style) } },
        hovertemplate: `${plain(label)}<br>%{x:.2f} ms, %{y:+.1f} %<extra></extra>`,
      };
    });
    return draw(element, traces, layout("processor time of encoding a frame [ms]", `BD-rate against ${plain(data.anchor)} [%]`, {
      xaxis: { type: "log" }, legend: true,
    }));
  }

  // ---- Charts are drawn when they come near, and again when colours change or the page is printed.

  function drawChart(element) {
    drawn.add(element);
    if (element.dataset.rd) return drawRd(element);
    return element.dataset.frames ? drawFrames(element) : drawCosts(element);
  }

  const allCharts = some("[data-rd], [data-frames], [data-costs]");
  const watcher = new IntersectionObserver((entries) => entries.forEach((entry) => {
    if (!entry.isIntersecting) return;
    watcher.unobserve(entry.target);
    drawChart(entry.target.querySelector("[data-rd], [data-frames], [data-costs]"));
  }), { rootMargin: "600px" });
  some("figure.chart").forEach((figure) => watcher.observe(figure));
  dark.addEventListener("change", () => drawn.forEach(drawChart));

  let opened = [];
  window.addEventListener("beforeprint", () => {
    opened = some("details:not([open]):not(.screen)");
    opened.forEach((part) => { part.open = true; });
    onPaper = true;
    allCharts.forEach(drawChart);
  });
  window.addEventListener("afterprint", () => {
    opened.forEach((part) => { part.open = false; });
    onPaper = false;
    drawn.forEach(drawChart);
  });
})();
