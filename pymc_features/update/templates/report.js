"use strict";
// What all figures share: the data, what is chosen, and buttons. Of a figure draw(place, element) is called at
// first, and again when one of the things in `on` is changed.
const BLUE = "#2563a8", INK = "#1f2933", GREY = "#8a96a3", RED = "#c8321e", GLOW = "#f07c00";
const COLOURS = ["#2563a8", "#2f855a", "#b7791f", "#7b4bb0", "#c8321e", "#0f8b8d", "#6b4f3a", "#4a5568"];
const LIGHT = "rgba(37,99,168,0.16)", MIDDLE = "rgba(37,99,168,0.42)";
const $ = id => document.getElementById(id), json = id => JSON.parse($(id).textContent);
const payload = json("payload");
const chosen = {kind: payload.kinds[0], sensor: 0, mode: 0, draws: null, predicted: 0, window: "all", parameters: null};
const figures = {}, figure = (name, on, draw, more) => { figures[name] = {on, draw, ...more}; };
const isTouch = matchMedia("(pointer: coarse)").matches;
const isNarrow = () => innerWidth < 700;

// Numbers of a packed array; nested as its shape says, null where there is none.
function unpack(p) {
  if (!p.values) {
    const bytes = Uint8Array.from(atob(p.b), letter => letter.charCodeAt(0));
    const whole = p.bits === 8 ? new Int8Array(bytes.buffer) : new Int16Array(bytes.buffer);
    const half = 2 ** (p.bits - 1) - 1;
    const flat = Array.from(whole, n => n < -half ? null : p.low + p.step * (n + half));
    p.values = nested(p.log ? flat.map(v => v === null ? null : 10 ** v) : flat, p.shape);
  }
  return p.values;
}

function nested(flat, shape) {
  if (shape.length < 2) return flat;
  const size = flat.length / shape[0];
  return Array.from({length: shape[0]}, (_, k) => nested(flat.slice(k * size, (k + 1) * size), shape.slice(1)));
}

const current = () => payload.of[chosen.kind];
const labelled = name => `${name} [${payload.parameters[name].unit}]`;

function layoutOf(extra) {
  const font = {family: '"Segoe UI", system-ui, sans-serif', size: 12, color: INK};
  return {
    margin: {l: 62, r: 14, t: 12, b: 44}, font, paper_bgcolor: "#fff", plot_bgcolor: "#fff",
    legend: {orientation: "h", x: 0, y: 1.01, yanchor: "bottom"}, hovermode: "closest",
    dragmode: isTouch ? false : "zoom", ...extra,
  };
}

const axis = (title, extra) => ({
  title: {text: title, standoff: 6}, gridcolor: "#e8ecf0", zeroline: false, linecolor: "#9aa5b1", showline: true,
  ticks: "outside", ticklen: 4, tickcolor: "#9aa5b1", automargin: true, ...extra,
});

function plot(place, traces, layout, extra) {
  return Plotly.react(place, traces, layoutOf(layout), {
    responsive: true, displaylogo: false, scrollZoom: false,
    modeBarButtonsToRemove: ["toImage", "lasso2d", "autoScale2d"], ...extra,
  });
}

// A band as a polygon for each stretch without gaps, so that it can be filled.
function band(x, low, high, colour, name, extra) {
  const xs = [], ys = [];
  for (let k = 0; k < x.length;) {
    while (k < x.length && low[k] === null) k++;
    const first = k;
    while (k < x.length && low[k] !== null) k++;
    if (k === first) continue;
    for (let i = first; i < k; i++) { xs.push(x[i]); ys.push(low[i]); }
    for (let i = k - 1; i >= first; i--) { xs.push(x[i]); ys.push(high[i]); }
    xs.push(null); ys.push(null);
  }
  return {
    x: xs, y: ys, fill: "toself", fillcolor: colour, line: {width: 0}, mode: "lines", name, hoverinfo: "skip", ...extra,
  };
}

const line = (x, y, colour, width, name, extra) =>
  ({x, y, mode: "lines", line: {color: colour, width}, name, ...extra});

// A figure of many small ones, one for each name.
function smalls(place, names, draw) {
  place.classList.add("grid");
  while (place.children.length > names.length) { Plotly.purge(place.lastChild); place.lastChild.remove(); }
  while (place.children.length < names.length) place.append(document.createElement("div"));
  names.forEach((name, k) => draw(place.children[k], name));
}

// A table that is wider than its place becomes one of cards, which shows the chosen likelihood alone.
function fit() {
  document.querySelectorAll("table").forEach(table => {
    table.classList.remove("cards");
    table.classList.toggle("cards", table.offsetWidth > table.parentElement.clientWidth + 1);
    [...table.tBodies[0].rows].forEach(row => {
      const {label} = row.cells[0].dataset;
      row.classList.toggle("other", label === "likelihood" && row.cells[0].textContent !== chosen.kind);
    });
  });
}

function change(what, value) {
  chosen[what] = value;
  if (what === "kind") { chosen.draws = null; chosen.parameters = null; fit(); }
  $("clear").hidden = !chosen.draws;
  if (chosen.draws) $("clear").textContent = `${chosen.draws.length} draws selected: clear`;
  for (const element of document.querySelectorAll("[data-figure]")) {
    const one = figures[element.dataset.figure];
    const draw = what === "draws" && one.light || one.draw;
    if (one.on.includes(what)) draw(element.querySelector(".plot"), element);
  }
}

function download(name, href) {
  const link = document.createElement("a");
  link.href = href; link.download = name;
  link.click();
}

const blobOf = (text, type) => URL.createObjectURL(new Blob([text], {type}));

// All plots of a figure as pictures, under names of their own.
function pictures(element, format) {
  const name = `${element.dataset.figure}-${chosen.kind}`;
  const one = figures[element.dataset.figure];
  if (one.picture) return one.picture(format, name);
  element.querySelectorAll(".js-plotly-plot").forEach((place, k) => {
    const {width, height} = place.getBoundingClientRect();
    const filename = k ? `${name}-${k + 1}` : name;
    Plotly.downloadImage(place, {format, width, height, scale: format === "png" ? 3 : 1, filename});
  });
}

function addButtons(element) {
  const place = element.querySelector(".buttons");
  const add = (text, act) => {
    const button = document.createElement("button");
    button.textContent = text; button.onclick = () => act(button);
    place.append(button);
  };
  if (isTouch && !figures[element.dataset.figure].picture) {
    add("Touch to zoom", button => {  // else a finger scrolls the page
      const on = button.textContent === "Touch to zoom";
      button.textContent = on ? "Touch to scroll" : "Touch to zoom";
      const mode = on ? figures[element.dataset.figure].drag || "zoom" : false;
      element.querySelectorAll(".js-plotly-plot").forEach(one => Plotly.relayout(one, {dragmode: mode}));
    });
  }
  add("PNG", () => pictures(element, "png"));
  add("SVG", () => pictures(element, "svg"));
}

function start() {
  const files = json("files");
  document.querySelectorAll("[data-file]").forEach(button => {
    button.onclick = () => download(button.dataset.file, blobOf(files[button.dataset.file], "text/plain"));
  });
  document.querySelector(".links").append(...[...document.querySelectorAll("section:not(#verdict)")].map(part => {
    const link = document.createElement("a");
    link.href = `#${part.id}`; link.textContent = part.querySelector("h2").textContent;
    return link;
  }));
  const choose = (id, names, what) => {
    if (!$(id)) return;
    if (names) $(id).replaceChildren(...names.map((name, k) => new Option(name, k)));
    $(id).onchange = () => change(what, names ? Number($(id).value) : $(id).value);
  };
  choose("kind", null, "kind");
  choose("sensor", payload.measured && payload.measured.sensors, "sensor");
  choose("mode", current().modes && current().modes.frequencies[0].map((_, k) => `f${k + 1}`), "mode");
  choose("part", null, "part");
  choose("predicted", payload.predicted && payload.predicted.map(one => `${one.motion}: ${one.label}`), "predicted");
  document.querySelectorAll("[data-window]").forEach(button => {
    button.onclick = () => change("window", button.dataset.window);
  });
  fit();
  addEventListener("resize", fit);
  $("clear").onclick = () => change("draws", null);
  const waiting = [...document.querySelectorAll("[data-figure]")];
  const next = () => {  // one after another, so that the page answers meanwhile
    const element = waiting.shift();
    if (!element) { document.body.dataset.ready = "yes"; return; }
    figures[element.dataset.figure].draw(element.querySelector(".plot"), element);
    addButtons(element);
    setTimeout(next);
  };
  next();
}

// On paper all plots are as wide as the sheet.
const plots = () => document.querySelectorAll(".js-plotly-plot");
addEventListener("beforeprint", () => plots().forEach(one =>
  Plotly.relayout(one, {autosize: false, width: one.parentElement.classList.contains("grid") ? 212 : 660})));
addEventListener("afterprint", () => plots().forEach(one => {
  Plotly.relayout(one, {autosize: true, width: null});
  Plotly.Plots.resize(one);
}));
