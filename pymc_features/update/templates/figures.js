// Figures of the posterior, of responses and of the data.

// Density of some draws on the places of another, as high as 1.
function densityOf(values, places) {
  const n = values.length, mean = values.reduce((a, b) => a + b, 0) / n;
  const sd = Math.sqrt(values.reduce((a, b) => a + (b - mean) ** 2, 0) / n);
  const width = Math.max(0.9 * sd * n ** -0.2, (places.at(-1) - places[0]) / 300);
  const heights = places.map(x => values.reduce((sum, v) => sum + Math.exp(-0.5 * ((x - v) / width) ** 2), 0));
  const top = Math.max(...heights, 1e-300);
  return heights.map(h => h / top);
}

function drawnOf(name) {
  const {names, values} = current().draws;
  const all = unpack(values[names.indexOf(name)]);
  return {all, some: chosen.draws ? chosen.draws.map(k => all[k]) : null};
}

figures.densities = {
  on: ["kind", "draws"],
  draw(place) {
    smalls(place, Object.keys(current().parameters), (small, name) => {
      const one = current().parameters[name];
      const x = unpack(one.x), y = unpack(one.y), [low, middle, high] = one.quantiles;
      const inside = x.map((v, k) => [v, y[k]]).filter(([v]) => v >= low && v <= high);
      const inset = row => one.is_log ? row.map(v => 10 ** v) : row;
      const at = v => y[x.reduce((best, w, k) => Math.abs(w - v) < Math.abs(x[best] - v) ? k : best, 0)];
      const traces = [
        line(x, y, BLUE, 1.5, "posterior", {fill: "tozeroy", fillcolor: LIGHT, hovertemplate: "%{x}<extra></extra>"}),
        line(inside.map(p => p[0]), inside.map(p => p[1]), BLUE, 0, "", {fill: "tozeroy", fillcolor: MIDDLE, hoverinfo: "skip"}),
        line([middle, middle], [0, at(middle)], BLUE, 2, "median", {hoverinfo: "skip"}),
        line(inset(unpack(one.prior_x)), unpack(one.prior_y), GREY, 1, "prior", {xaxis: "x2", yaxis: "y2", fill: "tozeroy", fillcolor: "#e3e7eb", hoverinfo: "skip"}),
        line(x, y, BLUE, 1.2, "", {xaxis: "x2", yaxis: "y2", fill: "tozeroy", fillcolor: MIDDLE, hoverinfo: "skip"}),
      ];
      const {some} = drawnOf(name);
      if (some) traces.push(line(x, densityOf(some, x), GLOW, 2, "selected", {hoverinfo: "skip"}));
      const hidden = {visible: false, fixedrange: true};
      plot(small, traces, {
        showlegend: false, margin: {l: 10, r: 10, t: 6, b: 42},
        xaxis: axis(labelled(name), {nticks: 6, showgrid: false}), yaxis: {...hidden, range: [0, 1.45]},
        xaxis2: {type: one.is_log ? "log" : "linear", exponentformat: "power", domain: [0.68, 1], anchor: "y2", nticks: 3, tickfont: {size: 9, color: GREY}, showgrid: false, zeroline: false, showline: true, linecolor: GREY, fixedrange: true, tickangle: 0},
        yaxis2: {...hidden, domain: [0.66, 1], anchor: "x2", range: [0, 1.15]},
      }, {displayModeBar: false});
    });
  },
};

const few = () => isNarrow() ? 3 : 5;  // parameters at once

figures.pairs = {
  on: ["kind", "parameters", "draws"], drag: "select",
  draw(place) {
    const names = current().draws.names;
    if (!chosen.parameters) chosen.parameters = names.slice(0, few());
    const shown = chosen.parameters, n = shown.length;
    chips(names);
    const size = place.clientWidth, each = size / n, gap = 0.025, wide = (1 + gap) / n - gap;
    const of = k => [k * (wide + gap), k * (wide + gap) + wide];
    const layout = {showlegend: false, dragmode: isTouch ? false : "select", margin: {l: 58, r: 8, t: 6, b: 56}, shapes: []};
    const look = {tickfont: {size: each < 120 ? 9 : 11}, nticks: each < 120 ? 3 : 5, showgrid: false, showline: false, anchor: "free", position: 0};
    const named = name => each < 150 ? `${name}<br>[${payload.parameters[name].unit}]` : labelled(name);
    const traces = [];
    shown.forEach((name, row) => {
      const id = row ? row + 1 : "", [low, high] = of(n - 1 - row);
      layout[`xaxis${id}`] = axis(named(name), {...look, domain: of(row), tickangle: 0});
      layout[`yaxis${id}`] = axis(row ? named(name) : "", {...look, domain: [low, high], showticklabels: row > 0, ticks: row ? "outside" : ""});
      layout[`yaxis${n + row + 1}`] = {domain: [low, high], visible: false, range: [0, 1.1], fixedrange: true, anchor: `x${id}`};
      const one = current().parameters[name], at = {xaxis: `x${id}`, yaxis: `y${n + row + 1}`};
      traces.push(line(unpack(one.x), unpack(one.y), BLUE, 1.3, "", {...at, fill: "tozeroy", fillcolor: LIGHT, hoverinfo: "skip"}));
      for (let column = 0; column <= row; column++) {
        const [x0, x1] = of(column);
        layout.shapes.push({type: "rect", xref: "paper", yref: "paper", x0, x1, y0: low, y1: high, line: {color: "#d0d6dc", width: 1}});
      }
    });
    shown.forEach((name, row) => shown.slice(0, row).forEach((other, column) => traces.push({
      x: drawnOf(other).all, y: drawnOf(name).all, xaxis: `x${column ? column + 1 : ""}`, yaxis: `y${row + 1}`,
      mode: "markers", type: "scatter", hoverinfo: "skip",
      marker: {color: BLUE, size: 3.5, opacity: 0.5},
      selected: {marker: {color: GLOW, opacity: 1, size: 4.5}}, unselected: {marker: {color: GREY, opacity: 0.18}},
    })));
    if (n === 1) traces.push({x: drawnOf(shown[0]).all, y: drawnOf(shown[0]).all.map((_, k) => (k % 97) / 97), yaxis: "y2", mode: "markers", marker: {color: BLUE, size: 3, opacity: 0.4}, hoverinfo: "skip", selected: {marker: {color: GLOW, opacity: 1}}});
    place.style.height = `${Math.max(280, Math.min(1.15 * size, 110 + 150 * n))}px`;
    plot(place, traces, layout, {displayModeBar: false});
    if (place.watched) return;
    place.watched = true;
    place.on("plotly_selected", event => {
      if (event) change("draws", event.points.length ? [...new Set(event.points.map(p => p.pointIndex))] : null);
    });
    place.on("plotly_deselect", () => change("draws", null));
  },
};

figures.pairs.light = place => {
  const scatter = place.data.map((trace, k) => trace.mode === "markers" ? k : -1).filter(k => k >= 0);
  Plotly.restyle(place, {selectedpoints: [chosen.draws]}, scatter);
  if (!chosen.draws) Plotly.relayout(place, {selections: []});
};

function chips(names) {
  if (names.length <= few()) { $("chosen").replaceChildren(); return; }
  $("chosen").replaceChildren(...names.map(name => {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox"; box.checked = chosen.parameters.includes(name);
    box.onchange = () => {
      const kept = names.filter(other => other === name ? box.checked : chosen.parameters.includes(other));
      if (kept.length && kept.length <= few() + 1) change("parameters", kept); else box.checked = !box.checked;
    };
    label.append(box, ` ${name}`);
    return label;
  }));
}

// Everything of one sensor under the current likelihood, bands as they are.
function responseOf(k) {
  const {measured} = payload, one = current().responses.sensors[k];
  const median = unpack(one.median), t = unpack(measured.time[k]), y = unpack(measured.values[k]);
  const off = (distance, sign) => median.map((m, i) => m === null || distance[i] === null ? null : m + sign * distance[i]);
  const found = {t, y, median, low: off(unpack(one.low), -1), high: off(unpack(one.high), 1), name: measured.sensors[k]};
  if (one.data_low) Object.assign(found, {dataLow: off(unpack(one.data_low), -1), dataHigh: off(unpack(one.data_high), 1)});
  found.residual = y.map((v, i) => v === null || median[i] === null ? null : v - median[i]);
  return found;
}

// Responses of the selected draws of which they are known, at most so many.
function selectedResponses(k, most = 25) {
  const {known} = current().draws, {coefficients, sensors} = current().responses;
  const parts = sensors[k].components.map(unpack), median = unpack(sensors[k].median);
  const some = (chosen.draws || []).filter(draw => draw < known).slice(0, most);
  return some.map(draw => median.map((m, i) => parts.reduce((sum, part, c) => sum + coefficients[draw][c] * part[i], m)));
}

function joined(x, rows) {
  return {x: rows.flatMap(() => [...x, null]), y: rows.flatMap(row => [...row, null])};
}

figures.response = {
  on: ["kind", "sensor", "draws", "window"],
  draw(place, element) {
    const {measured} = payload, one = responseOf(chosen.sensor), unit = measured.unit;
    const traces = [];
    if (one.dataLow) traces.push(band(one.t, one.dataLow, one.dataHigh, LIGHT, "data, 5 to 95 %"));
    traces.push(band(one.t, one.low, one.high, MIDDLE, "parameters, 5 to 95 %"));
    traces.push(line(one.t, one.y, INK, 1, "measured"), line(one.t, one.median, BLUE, 1.2, "median"));
    const lit = selectedResponses(chosen.sensor);
    if (lit.length) traces.push({...joined(one.t, lit), mode: "lines", line: {color: GLOW, width: 1}, opacity: 0.8, name: "selected draws", hoverinfo: "skip"});
    const below = {yaxis: "y2", showlegend: false}, minus = rows => rows.map((v, i) => v === null ? null : v - one.median[i]);
    if (one.dataLow) {
      traces.push(band(one.t, minus(one.dataLow), minus(one.dataHigh), LIGHT, "", below));
    }
    traces.push(line(one.t, one.residual, RED, 1, "residual", below));
    traces.push(band(one.t, minus(one.low), minus(one.high), MIDDLE, "", below));
    if (lit.length) traces.push({...joined(one.t, lit.map(minus)), mode: "lines", line: {color: GLOW, width: 1}, hoverinfo: "skip", ...below});
    const peak = one.t[one.y.reduce((best, v, k) => Math.abs(v || 0) > Math.abs(one.y[best] || 0) ? k : best, 0)];
    const first = one.t[0], last = one.t.at(-1), width = Math.min(last - first, Math.max(4, (last - first) / 20));
    const from = Math.max(first, Math.min(peak - 0.4 * width, last - width));
    plot(place, traces, {
      xaxis: axis(measured.displacement ? "sample" : "time [s]", {anchor: "y2", range: chosen.window === "all" ? [first, last] : [from, from + width]}),
      yaxis: axis(`${one.name} [${unit}]`, {domain: [0.38, 1]}),
      yaxis2: axis(`residual [${unit}]`, {domain: [0, 0.31]}), uirevision: `${chosen.sensor} ${chosen.window}`,
    });
    const [all, shown] = measured.samples, share = (100 * current().responses.share).toFixed(1);
    element.querySelector("figcaption").textContent =
      `${one.name} under ${chosen.kind}: the measurement, the median of the response and its 5 % to 95 % band from the uncertainty of the parameters`
      + (one.dataLow ? "; the light band is that of data drawn from the likelihood, where measured samples should lie" : "")
      + ". Below is the residual, the measurement less the median. Drag to zoom, and click twice for the whole. "
      + (shown < all ? `Of ${all} samples at most ${shown} are drawn, in each short stretch those where measurement and residual are largest and smallest. ` : "")
      + `Selected draws are drawn by the principal components that hold ${share} % of the variance of the responses.`;
  },
};

const markers = (values, dash, colour) => values.map(f => (
  {type: "line", xref: "x", yref: "paper", x0: f, x1: f, y0: 0, y1: 1, line: {dash, width: 1, color: colour}, layer: "below"}));

// A logarithmic axis that has most of some rows up to a frequency.
function decades(rows, f, top) {
  const values = rows.flatMap(row => row.filter((v, k) => v > 0 && f[k] <= top)).sort((a, b) => a - b);
  const range = [Math.log10(values[Math.floor(0.02 * values.length)]) - 0.3, Math.log10(values.at(-1)) + 0.15];
  return {type: "log", exponentformat: "power", range, dtick: range[1] - range[0] > 1.5 ? 1 : "D2"};
}

figures.spectra = {
  on: ["kind", "sensor"],
  draw(place) {
    const one = current().responses.sensors[chosen.sensor], f = unpack(one.frequency);
    const [y, median, residual] = unpack(one.spectra);
    const natural = current().frequencies ? current().frequencies.map(q => q[1]).filter(v => v < f.at(-1)) : [];
    const top = natural.length ? Math.min(f.at(-1), 1.5 * natural[Math.min(natural.length, 10) - 1]) : f.at(-1);
    plot(place, [line(f, y, INK, 1.2, "measured"), line(f, median, BLUE, 1.4, "median"), line(f, residual, RED, 1, "residual")], {
      xaxis: axis("frequency [Hz]", {range: [0, top]}),
      yaxis: axis(`${payload.measured.unit}/√Hz`, decades([y, residual], f, top)),
      shapes: markers(natural, "dot", GREY), uirevision: chosen.sensor,
    });
  },
};

figures.loops = {
  on: ["kind", "draws", "part"],
  draw(place) {
    const one = responseOf(0), d = unpack(payload.measured.displacement[0]), n = d.length, part = Number(chosen.part || 0);
    const cut = row => part ? row.slice(Math.floor((part - 1) * n / 3), Math.ceil(part * n / 3)) : row;
    const x = cut(d), traces = [
      line(x, cut(one.low), MIDDLE, 1, "5 % and 95 %"), line(x, cut(one.high), MIDDLE, 1, "", {showlegend: false}),
      line(x, cut(one.median), BLUE, 1.6, "median"), line(x, cut(one.y), INK, 1.2, "measured", {line: {color: INK, width: 1.2, dash: "dot"}}),
    ];
    const lit = selectedResponses(0).map(cut);
    if (lit.length) traces.push({...joined(x, lit), mode: "lines", line: {color: GLOW, width: 1}, name: "selected draws", hoverinfo: "skip"});
    plot(place, traces, {xaxis: axis("displacement [mm]"), yaxis: axis(`force [${payload.measured.unit}]`)});
  },
};

figures.singular = {
  on: ["kind"],
  draw(place) {
    const {frequency, values, bands, identified} = payload.spectra, f = unpack(frequency), rows = unpack(values);
    const traces = rows.map((row, k) => line(f, row, k ? "#b8c0c8" : INK, k ? 0.9 : 1.3, k ? "others" : "first", {showlegend: k < 2})).reverse();
    const fitted = current().singular_values, at = unpack(fitted.frequency), [low, median, high] = unpack(fitted.values);
    const inBand = (x, [a, b]) => x >= a && x <= b;
    low.forEach((_, k) => bands.forEach((ends, b) => {
      const pick = row => row.filter((_, i) => inBand(at[i], ends)), x = pick(at);
      traces.push(band(x, pick(low[k]), pick(high[k]), "rgba(200,50,30,0.25)", "", {showlegend: false}));
      traces.push(line(x, pick(median[k]), RED, 1.3, "model", {showlegend: !k && !b}));
    }));
    const shaded = bands.map(([x0, x1]) => ({type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: LIGHT, line: {width: 0}, layer: "below"}));
    const highest = Math.max(...rows[0]), end = Math.max(...bands.flat());
    plot(place, traces, {
      xaxis: axis("frequency [Hz]", {range: [0, Math.min(f.at(-1), 1.25 * end)]}),
      yaxis: axis("(m/s²)²/Hz", {type: "log", exponentformat: "power", range: [Math.log10(highest) - 6, Math.log10(highest) + 0.4]}),
      shapes: [...shaded, ...markers(identified || [], "dot", GREY)],
    });
  },
};

figures.mac = {
  on: ["kind"],
  draw(place) {
    const {names, partners, mac, frequencies} = current().modes.identified, columns = mac[0].map((_, k) => `f${k + 1}`);
    const rows = names.map((name, k) => `${name}: ${frequencies[k]} Hz`);
    plot(place, [{
      type: "heatmap", x: columns, y: rows, z: mac, zmin: 0, zmax: 1, xgap: 2, ygap: 2, showscale: !isNarrow(),
      colorscale: [[0, "#f4f7fb"], [1, BLUE]], text: mac.map(row => row.map(v => v === null ? "" : v.toFixed(2))), texttemplate: "%{text}",
      hovertemplate: "identified %{y}, model %{x}: MAC %{z:.3f}<extra></extra>",
    }], {
      xaxis: axis("mode of the model", {showgrid: false, type: "category"}), yaxis: axis("identified mode", {autorange: "reversed", type: "category", showgrid: false}),
      shapes: partners.map((p, row) => ({type: "rect", x0: p - 1.5, x1: p - 0.5, y0: row - 0.5, y1: row + 0.5, line: {color: GLOW, width: 2.5}})).filter((_, row) => partners[row]),
    });
  },
};

figures.frequencies = {
  on: [],
  draw(place) {
    const {frequency, gain, peaks, given} = payload.data, f = unpack(frequency);
    const kinds = payload.kinds.filter(kind => payload.of[kind].frequencies);
    const traces = unpack(gain).map((row, k) => line(f, row, COLOURS[k % COLOURS.length], 1.1, payload.measured.sensors[k]));
    kinds.forEach(kind => payload.of[kind].frequencies.forEach(([low, median, high], k) => {
      traces.push({x: [low, high], y: [kind, kind], yaxis: "y2", mode: "lines", line: {color: BLUE, width: 7}, showlegend: false, hoverinfo: "skip"});
      traces.push({x: [median], y: [kind], yaxis: "y2", mode: "markers", marker: {color: INK, size: 9, symbol: "line-ns-open"}, showlegend: false, hovertemplate: `f${k + 1}: %{x:.4f} Hz<extra>${kind}</extra>`});
    }));
    const tops = payload.of[kinds[0]].frequencies, last = tops[Math.min(tops.length, 10) - 1][2];
    plot(place, traces, {
      xaxis: axis("frequency [Hz]", {anchor: "y2", range: [0, Math.min(f.at(-1), 1.25 * last)]}),
      yaxis: axis("gain [-]", {domain: [0.36, 1], ...decades(unpack(gain), f, 1.25 * last)}),
      yaxis2: axis("", {type: "category", domain: [0, 0.26], autorange: "reversed"}),
      shapes: [...markers(peaks, "dot", GREY), ...markers(given || [], "dash", RED)],
    });
  },
};

figures.record = {
  on: [],
  draw(place) {
    const {time, base} = payload.data;
    plot(place, [line(unpack(time), unpack(base), INK, 1, payload.data.name)], {xaxis: axis("time [s]"), yaxis: axis("base [m/s²]")});
  },
};

figures.events = {
  on: ["kind"],
  draw(place) {
    const {names, events, mean, half, alarm} = current().events, x = events.map((_, k) => k + 1);
    smalls(place, names, (small, name) => {
      const k = names.indexOf(name), low = mean[k].map((m, i) => m - half[k][i]), high = mean[k].map((m, i) => m + half[k][i]);
      const lines = x.filter((_, i) => alarm[i]);
      plot(small, [band(x, low, high, LIGHT, ""), {x, y: mean[k], mode: "lines+markers", line: {color: BLUE}, text: events, hovertemplate: "%{text}: %{y}<extra></extra>"}], {
        showlegend: false, margin: {l: 60, r: 8, t: 8, b: 40}, shapes: markers(lines, "dash", RED),
        xaxis: axis("event", {dtick: Math.ceil(x.length / 8)}), yaxis: axis(labelled(name), {nticks: 4}),
      }, {displayModeBar: false});
    });
  },
};

figures.stages = {
  on: ["kind"],
  draw(place) {
    const stages = current().stages;
    if (!stages) { Plotly.purge(place); place.textContent = `${chosen.kind} was sampled without stages.`; return; }
    place.firstChild && !place.data && place.replaceChildren();
    const x = row => row.map((_, k) => k + 1), positive = row => row.map(v => v > 0 ? v : null);
    const chain = (row, k, extra) => ({x: x(row), y: row, mode: "lines+markers", marker: {size: 4}, line: {color: COLOURS[k % COLOURS.length], width: 1}, name: `chain ${k}`, ...extra});
    plot(place, [...stages.values.map((row, k) => chain(positive(row), k)), ...stages.accept.map((row, k) => chain(row, k, {xaxis: "x2", yaxis: "y2", showlegend: false}))], {
      xaxis: axis("stage", {domain: [0, 0.44]}), yaxis: axis(stages.name === "beta" ? "inverse temperature [-]" : "tolerance", {type: "log", exponentformat: "power"}),
      xaxis2: axis("stage", {domain: [0.58, 1], anchor: "y2"}), yaxis2: axis("acceptance [-]", {range: [0, 1], anchor: "x2"}),
    });
  },
};

figures.ranks = {
  on: ["kind"],
  draw(place) {
    const ranks = current().ranks || {};
    smalls(place, Object.keys(ranks), (small, name) => {
      const u = unpack(ranks[name].u), half = unpack(ranks[name].half);
      const traces = ranks[name].shares.map((row, k) => line(u, unpack(row), COLOURS[k % COLOURS.length], 1.2, `chain ${k}`));
      plot(small, [band(u, half.map(h => -h), half, "#e3e7eb", ""), ...traces], {
        showlegend: false, margin: {l: 52, r: 8, t: 8, b: 40},
        xaxis: axis(`${name}: fractional rank`, {nticks: 4}), yaxis: axis("", {nticks: 4}),
      }, {displayModeBar: false});
    });
  },
};
