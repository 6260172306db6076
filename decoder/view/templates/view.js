"use strict";
// Colours that differ without colour vision (Okabe and Ito).
const KINDS = { key: "#0072b2", tracks: "#cc79a7", parity: "#e69f00", crc: "#56b4e9", header: "#999999" };
const POLL_MS = 500, SHOWN_FRAMES = 120, MOST_ROWS = 1000, PAD_PX = 20;
const SVG = "http://www.w3.org/2000/svg";
const at = (id) => document.getElementById(id);
const rows = new Map();
let state = null, latest = -1, shown = -1;

function drawn(name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

const sum = (bits) => Object.values(bits).reduce((total, own) => total + own, 0);

function cells(...texts) {
  const row = document.createElement("tr");
  texts.forEach((text, number) => {
    const cell = document.createElement(number ? "td" : "th");
    if (number) cell.className = "number"; else cell.scope = "row";
    cell.textContent = text;
    row.append(cell);
  });
  return row;
}

function drawProgress() {
  const { num_frames: count, total, finished, requests_in_flight: requests } = state;
  const seconds = count / state.frame_rate;
  const rate = seconds ? `${(sum(state.bits) / seconds / 1000).toFixed(1)} kbit/s` : "";
  const flight = requests === null || finished ? "" : `, ${requests} requests in flight`;
  at("title").textContent = state.name;
  at("facts").textContent = state.facts;
  at("progress").textContent = `${count}${total ? ` of ${total}` : ""} frames, ${rate}${flight}${finished ? ": all decoded" : ""}`;
  if (total || finished) at("done").value = finished ? 1 : count / total; else at("done").removeAttribute("value");
}

function drawBits() {
  const chart = at("bits"), last = [...rows.values()].slice(-SHOWN_FRAMES);
  const sums = last.map((row) => sum(row.bits));
  const most = Math.max(...sums, 1), width = (960 - 2 * PAD_PX) / Math.max(last.length, 32);
  chart.replaceChildren(drawn("text", { x: 4, y: 14 }, `${(most / 1000).toFixed(1)} kbit`));
  last.forEach((row, number) => {
    let bottom = 220;
    for (const [kind, colour] of Object.entries(KINDS)) {
      const height = ((row.bits[kind] || 0) / most) * 200;
      bottom -= height;
      chart.append(drawn("rect", { x: PAD_PX + number * width, y: bottom, width: Math.max(width - 1, 1), height, fill: colour }));
    }
    if (row.index === shown) chart.append(drawn("rect", { x: PAD_PX + number * width, y: 222, width: Math.max(width - 1, 2), height: 6, fill: "currentColor" }));
  });
  if (last.length) chart.append(drawn("text", { x: PAD_PX, y: 238 }, `frame ${last[0].index} to ${last[last.length - 1].index}`));
  const all = sum(state.bits) || 1;
  at("totals").replaceChildren(...Object.entries(state.bits).map(([kind, bits]) => cells(kind, (bits / 1000).toFixed(1), `${(100 * bits / all).toFixed(1)} %`)));
}

// Frames with known cameras in the group of pictures of a frame.
function groupOf(index) {
  const group = rows.has(index) ? rows.get(index).group : -1;
  return [...rows.values()].filter((row) => row.group === group && row.centre);
}

function drawPath() {
  const path = at("path"), group = groupOf(shown);
  path.replaceChildren();
  if (!group.length) {
    path.append(drawn("text", { x: PAD_PX, y: 30 }, "no camera is known of this frame"));
    return;
  }
  const places = group.map((row) => [row.centre[0], -row.centre[2]]);
  const low = [0, 1].map((axis) => Math.min(...places.map((place) => place[axis])));
  const high = [0, 1].map((axis) => Math.max(...places.map((place) => place[axis])));
  const size = Math.max((high[0] - low[0]) / 920, (high[1] - low[1]) / 280, 1e-12);
  const drawnAt = (place) => [0, 1].map((axis) => (axis ? 160 : 480) + (place[axis] - (low[axis] + high[axis]) / 2) / size);
  path.append(drawn("polyline", { points: places.map((place) => drawnAt(place).join(",")).join(" "), fill: "none", stroke: KINDS.key, "stroke-width": 2 }));
  group.forEach((row, number) => {
    const [cx, cy] = drawnAt(places[number]), here = row.index === shown;
    path.append(drawn("circle", { cx, cy, r: here ? 7 : 3, fill: here ? KINDS.parity : KINDS.key }));
    if (here) path.append(drawn("text", { x: Math.min(cx + 10, 860), y: Math.max(cy - 10, 16) }, `frame ${row.index}`));
  });
}

function drawFrame() {
  const row = rows.get(shown);
  if (!row) return;
  const psnr = row.psnr_y_db == null ? "" : `, ${row.psnr_y_db.toFixed(2)} dB`;
  const how = row.type === "key" ? "key frame" : `predicted by ${row.side_information}${row.side_information_reason ? ` (${row.side_information_reason})` : ""}`;
  at("told").textContent = `Frame ${row.index}: ${how}, ${(sum(row.bits) / 1000).toFixed(2)} kbit${psnr}`;
  const kept = state.first_picture !== null && shown >= state.first_picture;
  for (const figure of document.querySelectorAll("figure[data-kind]")) {
    const kind = figure.dataset.kind, image = figure.querySelector("img");
    const there = kept && (kind === "decoded" || (row.type !== "key" && (kind !== "depth" || row.has_depth)));
    figure.classList.toggle("absent", !there);
    image.hidden = false;
    if (there) image.src = `/pictures/${shown}/${kind}.jpg`; else image.removeAttribute("src");
  }
}

function show(index) {
  shown = index;
  at("frame").value = index;
  drawFrame(); drawBits(); drawPath();
}

async function poll() {
  try {
    const answer = await fetch(`/state?after=${latest}`);
    if (answer.ok) {
      state = await answer.json();
      for (const row of state.rows) {
        rows.set(row.index, row);
        if (rows.size > MOST_ROWS) rows.delete(rows.keys().next().value);
        latest = row.index;
      }
      drawProgress();
      if (state.rows.length) {
        at("frame").max = latest;
        at("frame").min = rows.keys().next().value;
        if (at("follow").checked || shown < 0) show(latest); else drawBits();
      }
    }
  } catch {
    at("progress").textContent = "dvc-decode has ended";
    return;
  }
  if (!(state && state.finished)) setTimeout(poll, POLL_MS);
}

for (const [kind, colour] of Object.entries(KINDS)) {
  const swatch = document.createElement("span");
  swatch.className = "swatch";
  swatch.style.background = colour;
  at("key").append(swatch, kind);
}
at("frame").addEventListener("input", () => { at("follow").checked = false; show(Number(at("frame").value)); });
at("follow").addEventListener("change", () => { if (at("follow").checked && latest >= 0) show(latest); });
poll();
