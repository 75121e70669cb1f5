// Figures of the posterior, of responses and of the data.
const quiet = {hoverinfo: "skip", showlegend: false};
const filled = (x, y, colour, width, fillcolor, extra) =>
  line(x, y, colour, width, "", {fill: "tozeroy", fillcolor, ...quiet, ...extra});
const colour = k => COLOURS[k % COLOURS.length];
const markers = (values, dash, color) => values.map(f => (
  {type: "line", xref: "x", yref: "paper", x0: f, x1: f, y0: 0, y1: 1, line: {dash, width: 1, color}, layer: "below"}));

// Several lines as one trace, for draws that are selected.
const selected = (x, rows, extra) => line(
  rows.flatMap(() => [...x, null]), rows.flatMap(row => [...row, null]), GLOW, 1, "selected draws",
  {hoverinfo: "skip", opacity: 0.8, ...extra});

// Density of some draws on the places of another, as high as 1.
function densityOf(values, places) {
  const n = values.length, mean = values.reduce((a, b) => a + b, 0) / n;
  const sd = Math.sqrt(values.reduce((a, b) => a + (b - mean) ** 2, 0) / n);
  const width = Math.max(0.9 * sd * n ** -0.2, (places.at(-1) - places[0]) / 300);
  const heights = places.map(x => values.reduce((sum, v) => sum + Math.exp(-0.5 * ((x - v) / width) ** 2), 0));
  const top = Math.max(...heights, 1e-300);
  return heights.map(h => h / top);
}

const drawsOf = name => unpack(current().draws.values[current().draws.names.indexOf(name)]);

figure("densities", ["kind", "draws"], place => {
  smalls(place, Object.keys(current().parameters), (small, name) => {
    const one = current().parameters[name], inset = {xaxis: "x2", yaxis: "y2"};
    const x = unpack(one.x), y = unpack(one.y), [low, middle, high] = one.quantiles;
    const inside = x.flatMap((v, k) => v >= low && v <= high ? [k] : []);
    const nearest = x.reduce((best, v, k) => Math.abs(v - middle) < Math.abs(x[best] - middle) ? k : best, 0);
    const places = unpack(one.prior_x).map(v => one.is_log ? 10 ** v : v);
    const traces = [
      filled(x, y, BLUE, 1.5, LIGHT, {hoverinfo: "x"}),
      filled(inside.map(k => x[k]), inside.map(k => y[k]), BLUE, 0, MIDDLE),
      line([middle, middle], [0, y[nearest]], BLUE, 2, "median", quiet),
      filled(places, unpack(one.prior_y), GREY, 1, "#e3e7eb", inset),
      filled(x, y, BLUE, 1.2, MIDDLE, inset),
    ];
    if (chosen.draws) {
      const all = drawsOf(name);
      traces.push(line(x, densityOf(chosen.draws.map(k => all[k]), x), GLOW, 2, "selected", quiet));
    }
    const hidden = {visible: false, fixedrange: true};
    plot(small, traces, {
      margin: {l: 10, r: 10, t: 6, b: 42},
      xaxis: axis(labelled(name), {nticks: 6, showgrid: false, tickangle: 0}), yaxis: {...hidden, range: [0, 1.45]},
      xaxis2: axis("", {
        type: one.is_log ? "log" : "linear", exponentformat: "power", domain: [0.68, 1], anchor: "y2", nticks: 3,
        tickfont: {size: 9, color: GREY}, showgrid: false, fixedrange: true, tickangle: 0, ticks: "",
      }),
      yaxis2: {...hidden, domain: [0.66, 1], anchor: "x2", range: [0, 1.15]},
    }, {displayModeBar: false});
  });
});

const few = () => isNarrow() ? 3 : 5;  // parameters at once

figure("pairs", ["kind", "parameters", "draws"], place => {
  const names = current().draws.names;
  if (!chosen.parameters) chosen.parameters = names.slice(0, few());
  chips(names);
  const shown = chosen.parameters, n = shown.length, size = place.clientWidth, isSmall = size / n < 130;
  const gap = 0.025, wide = (1 + gap) / n - gap, of = k => [k * (wide + gap), k * (wide + gap) + wide];
  const look = {
    tickfont: {size: isSmall ? 9 : 11}, nticks: isSmall ? 3 : 5, showgrid: false, showline: false, tickangle: 0,
    anchor: "free", position: 0,
  };
  const named = name => isSmall ? `${name}<br>[${payload.parameters[name].unit}]` : labelled(name);
  const layout = {dragmode: isTouch ? false : "select", margin: {l: 58, r: 8, t: 6, b: 56}, shapes: []};
  const traces = [];
  shown.forEach((name, row) => {
    const id = row ? row + 1 : "", domain = of(n - 1 - row), one = current().parameters[name];
    const hidden = row ? {tickangle: "auto"} : {showticklabels: false, ticks: ""};
    layout[`xaxis${id}`] = axis(named(name), {...look, domain: of(row), nticks: isSmall ? 2 : 5});
    layout[`yaxis${id}`] = axis(row ? named(name) : "", {...look, domain, ...hidden});
    layout[`yaxis${n + row + 1}`] = {domain, visible: false, range: [0, 1.1], fixedrange: true, anchor: `x${id}`};
    const at = {xaxis: `x${id}`, yaxis: `y${n + row + 1}`};
    traces.push(filled(unpack(one.x), unpack(one.y), BLUE, 1.3, LIGHT, at));
    shown.slice(0, row + 1).forEach((other, column) => {
      const [x0, x1] = of(column), [y0, y1] = domain;
      layout.shapes.push(
        {type: "rect", xref: "paper", yref: "paper", x0, x1, y0, y1, line: {color: "#d0d6dc", width: 1}});
      if (column < row) traces.push({
        x: drawsOf(other), y: drawsOf(name), xaxis: `x${column ? column + 1 : ""}`, yaxis: `y${row + 1}`,
        mode: "markers", ...quiet, marker: {color: BLUE, size: 3.5, opacity: 0.5},
        selected: {marker: {color: GLOW, opacity: 1, size: 4.5}},
        unselected: {marker: {color: GREY, opacity: 0.18}},
      });
    });
  });
  place.style.height = `${Math.max(280, Math.min(1.15 * size, 110 + 150 * n))}px`;
  plot(place, traces, layout, {displayModeBar: false});
  if (place.watched) return;
  place.watched = true;
  place.on("plotly_selected", event => {
    if (event) change("draws", event.points.length ? [...new Set(event.points.map(p => p.pointIndex))] : null);
  });
  place.on("plotly_deselect", () => change("draws", null));
}, {
  drag: "select",
  light(place) {
    const scatter = place.data.flatMap((trace, k) => trace.mode === "markers" ? [k] : []);
    if (scatter.length) Plotly.restyle(place, {selectedpoints: [chosen.draws]}, scatter);
    if (!chosen.draws) Plotly.relayout(place, {selections: []});
  },
});

// Which parameters are drawn, where there is no room for all.
function chips(names) {
  $("chosen").replaceChildren(...(names.length > few() ? names : []).map(name => {
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

const minus = (rows, others, factor = 1) =>
  rows.map((v, i) => v === null || others[i] === null ? null : v - factor * others[i]);

// Everything of one sensor under the current likelihood, bands as they are.
function responseOf(k) {
  const {measured} = payload, one = current().responses.sensors[k];
  const median = unpack(one.median), off = (name, sign) => minus(median, unpack(one[name]), sign);
  const found = {t: unpack(measured.time[k]), y: unpack(measured.values[k]), median, name: measured.sensors[k]};
  Object.assign(found, {low: off("low", 1), high: off("high", -1), residual: minus(found.y, median)});
  if (one.data_low) Object.assign(found, {dataLow: off("data_low", 1), dataHigh: off("data_high", -1)});
  return found;
}

// Responses of the selected draws of which they are known, at most so many.
function selectedResponses(k, most = 25) {
  const {known} = current().draws, {coefficients, sensors} = current().responses;
  const parts = sensors[k].components.map(unpack), median = unpack(sensors[k].median);
  const some = (chosen.draws || []).filter(draw => draw < known).slice(0, most);
  return some.map(draw => median.map((m, i) => parts.reduce((sum, part, c) => sum + coefficients[draw][c] * part[i], m)));
}

// The whole of a record, or a twentieth of it around its largest value, but 4 s at least.
function windowOf({t, y}) {
  const first = t[0], last = t.at(-1), width = Math.min(last - first, Math.max(4, (last - first) / 20));
  const peak = t[y.reduce((best, v, k) => Math.abs(v || 0) > Math.abs(y[best] || 0) ? k : best, 0)];
  const from = Math.max(first, Math.min(peak - 0.4 * width, last - width));
  return chosen.window === "all" ? [first, last] : [from, from + width];
}

figure("response", ["kind", "sensor", "draws", "window"], (place, element) => {
  const {measured} = payload, one = responseOf(chosen.sensor), below = {yaxis: "y2", showlegend: false};
  const bands = [[one.low, one.high, MIDDLE, "parameters, 5 to 95 %"]];
  if (one.dataLow) bands.unshift([one.dataLow, one.dataHigh, LIGHT, "data, 5 to 95 %"]);
  const lit = selectedResponses(chosen.sensor), less = row => minus(row, one.median);
  const traces = [
    ...bands.flatMap(([low, high, ...look]) => [
      band(one.t, low, high, ...look), band(one.t, less(low), less(high), ...look, below),
    ]),
    line(one.t, one.y, INK, 1, "measured"), line(one.t, one.median, BLUE, 1.2, "median"),
    line(one.t, one.residual, RED, 1, "residual", below),
  ];
  if (lit.length) traces.push(selected(one.t, lit), selected(one.t, lit.map(less), below));
  plot(place, traces, {
    xaxis: axis(measured.displacement ? "sample" : "time [s]", {anchor: "y2", range: windowOf(one)}),
    yaxis: axis(`${one.name} [${measured.unit}]`, {domain: [0.38, 1]}),
    yaxis2: axis(`residual [${measured.unit}]`, {domain: [0, 0.31]}),
    uirevision: `${chosen.sensor} ${chosen.window}`,
  });
  const [all, most] = measured.samples, share = (100 * current().responses.share).toFixed(1);
  const light = one.dataLow ? " The light band is that of data drawn from the likelihood, where samples should lie." : "";
  const thinned = most < all ? ` Of ${all} samples at most ${most} are drawn, in each short stretch those where `
    + "measurement and residual are largest and smallest." : "";
  element.querySelector("figcaption").textContent =
    `The measurement at ${one.name}, the median of the response under ${chosen.kind}, and its 5 % to 95 % band from `
    + `the uncertainty of the parameters.${light} Below is the residual, the measurement less the median. Drag to `
    + `zoom, and click twice for the whole.${thinned} Selected draws are drawn by the components that hold ${share} % `
    + "of the variance of the responses.";
});

// A logarithmic axis that has most of some rows up to a frequency.
function decades(rows, f, top) {
  const values = rows.flatMap(row => row.filter((v, k) => v > 0 && f[k] <= top)).sort((a, b) => a - b);
  const range = [Math.log10(values[Math.floor(0.02 * values.length)]) - 0.3, Math.log10(values.at(-1)) + 0.15];
  return {type: "log", exponentformat: "power", range, dtick: range[1] - range[0] > 1.5 ? 1 : "D2"};
}

// Up to where modes are drawn: a little above the tenth, or the last.
const topOf = (f, natural) => Math.min(f.at(-1), 1.4 * (natural[Math.min(natural.length, 10) - 1] || f.at(-1)));

figure("spectra", ["kind", "sensor"], place => {
  const one = current().responses.sensors[chosen.sensor], f = unpack(one.frequency);
  const [y, median, residual] = unpack(one.spectra);
  const natural = (current().frequencies || []).map(q => q[1]).filter(v => v < f.at(-1)), top = topOf(f, natural);
  plot(place, [line(f, y, INK, 1.2, "measured"), line(f, median, BLUE, 1.4, "median"), line(f, residual, RED, 1, "residual")], {
    xaxis: axis("frequency [Hz]", {range: [0, top]}), shapes: markers(natural, "dot", GREY),
    yaxis: axis(`${payload.measured.unit}/√Hz`, decades([y, residual], f, top)), uirevision: chosen.sensor,
  });
});

figure("loops", ["kind", "draws", "part"], place => {
  const one = responseOf(0), d = unpack(payload.measured.displacement[0]), third = d.length / 3;
  const part = Number(chosen.part || 0);
  const cut = row => part ? row.slice(Math.floor((part - 1) * third), Math.ceil(part * third)) : row;
  const x = cut(d), lit = selectedResponses(0).map(cut);
  plot(place, [
    line(x, cut(one.low), MIDDLE, 1, "5 % and 95 %"), line(x, cut(one.high), MIDDLE, 1, "", {showlegend: false}),
    line(x, cut(one.median), BLUE, 1.6, "median"),
    line(x, cut(one.y), INK, 1.2, "measured", {line: {color: INK, width: 1.2, dash: "dot"}}),
    ...(lit.length ? [selected(x, lit)] : []),
  ], {xaxis: axis("displacement [mm]"), yaxis: axis(`force [${payload.measured.unit}]`)});
});

figure("singular", ["kind"], place => {
  const {frequency, values, bands, identified} = payload.spectra, f = unpack(frequency), rows = unpack(values);
  const fitted = current().singular_values, at = unpack(fitted.frequency), [low, median, high] = unpack(fitted.values);
  const traces = rows.map((row, k) => k
    ? line(f, row, "#b8c0c8", 0.9, "others", {showlegend: k < 2}) : line(f, row, INK, 1.3, "first")).reverse();
  low.forEach((_, k) => bands.forEach(([from, to], b) => {
    const pick = row => row.filter((_, i) => at[i] >= from && at[i] <= to), x = pick(at);
    traces.push(band(x, pick(low[k]), pick(high[k]), "rgba(200,50,30,0.25)", "", quiet));
    traces.push(line(x, pick(median[k]), RED, 1.3, "model", {showlegend: !k && !b}));
  }));
  const shaded = bands.map(([x0, x1]) => ({
    type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, fillcolor: LIGHT, line: {width: 0}, layer: "below",
  }));
  const highest = Math.log10(Math.max(...rows[0]));
  plot(place, traces, {
    xaxis: axis("frequency [Hz]", {range: [0, Math.min(f.at(-1), 1.25 * Math.max(...bands.flat()))]}),
    yaxis: axis("(m/s²)²/Hz", {type: "log", exponentformat: "power", range: [highest - 6, highest + 0.4]}),
    shapes: [...shaded, ...markers(identified || [], "dot", GREY)],
  });
});

figure("mac", ["kind"], place => {
  const {names, partners, mac, frequencies} = current().modes.identified;
  plot(place, [{
    type: "heatmap", x: mac[0].map((_, k) => `f${k + 1}`), y: names.map((name, k) => `${name}: ${frequencies[k]} Hz`),
    z: mac, zmin: 0, zmax: 1, xgap: 2, ygap: 2, showscale: !isNarrow(), colorscale: [[0, "#f4f7fb"], [1, BLUE]],
    text: mac.map(row => row.map(v => v === null ? "" : v.toFixed(2))), texttemplate: "%{text}",
    hovertemplate: "identified %{y}, model %{x}: MAC %{z:.3f}<extra></extra>",
  }], {
    xaxis: axis("mode of the model", {showgrid: false, type: "category"}),
    yaxis: axis("identified mode", {autorange: "reversed", type: "category", showgrid: false}),
    shapes: partners.flatMap((p, row) => p ? [{
      type: "rect", x0: p - 1.5, x1: p - 0.5, y0: row - 0.5, y1: row + 0.5, line: {color: GLOW, width: 2.5},
    }] : []),
  });
});

figure("frequencies", [], place => {
  const {frequency, gain, peaks, given} = payload.data, f = unpack(frequency), rows = unpack(gain);
  const kinds = payload.kinds.filter(kind => payload.of[kind].frequencies);
  const traces = rows.map((row, k) => line(f, row, colour(k), 1.1, payload.measured.sensors[k]));
  kinds.forEach(kind => payload.of[kind].frequencies.forEach(([low, median, high], k) => traces.push(
    line([low, high], [kind, kind], BLUE, 7, "", {yaxis: "y2", ...quiet}),
    {
      x: [median], y: [kind], yaxis: "y2", mode: "markers", marker: {color: INK, size: 9, symbol: "line-ns-open"},
      showlegend: false, hovertemplate: `f${k + 1}: %{x:.4f} Hz<extra>${kind}</extra>`,
    },
  )));
  const top = topOf(f, payload.of[kinds[0]].frequencies.map(q => q[2]));
  plot(place, traces, {
    xaxis: axis("frequency [Hz]", {anchor: "y2", range: [0, top]}),
    yaxis: axis("gain [-]", {domain: [0.36, 1], ...decades(rows, f, top)}),
    yaxis2: axis("", {type: "category", domain: [0, 0.26], autorange: "reversed"}),
    shapes: [...markers(peaks, "dot", GREY), ...markers(given || [], "dash", RED)],
  });
});

figure("record", [], place => {
  const {time, base, name} = payload.data;
  plot(place, [line(unpack(time), unpack(base), INK, 1, name)], {xaxis: axis("time [s]"), yaxis: axis("base [m/s²]")});
});

figure("prediction", ["predicted"], (place, element) => {
  const one = payload.predicted[chosen.predicted], t = unpack(one.time), peaks = unpack(one.peaks), n = peaks.length;
  const [low, median, high] = unpack(one.quantiles), right = {xaxis: "x2", yaxis: "y2"};
  plot(place, [
    band(t, low, high, MIDDLE, "5 to 95 %"), line(t, median, BLUE, 1.2, "median"),
    line(peaks, peaks.map((_, k) => 1 - (k + 0.5) / n), BLUE, 1.6, "exceeded", {...right, showlegend: false}),
    {
      x: one.limits, y: one.probabilities, ...right, mode: "markers", name: "limits", marker: {color: RED, size: 8},
      showlegend: one.limits.length > 0, error_y: {type: "data", array: one.errors, color: RED, thickness: 1},
    },
  ], {
    xaxis: axis("time [s]"), yaxis: axis(`${one.place} [${one.unit}]`, {domain: [0.48, 1]}),
    xaxis2: axis(`largest ${one.label} [${one.unit}]`, {anchor: "y2"}),
    yaxis2: axis("probability", {domain: [0, 0.36], range: [-0.02, 1.02], anchor: "x2"}), uirevision: chosen.predicted,
  });
  element.querySelector("figcaption").textContent = `Above, ${one.place} under ${one.motion}, where it is largest: median `
    + "and 5 to 95 %, from the uncertainty of the parameters. Below, the probability that the largest value anywhere "
    + "exceeds one on the axis, and in red that of each limit.";
});

figure("events", ["kind"], place => {
  const {names, events, mean, half, alarm} = current().events, x = events.map((_, k) => k + 1);
  smalls(place, names, (small, name) => {
    const k = names.indexOf(name), middle = {x, y: mean[k], mode: "lines+markers", line: {color: BLUE}, text: events};
    plot(small, [band(x, minus(mean[k], half[k]), minus(mean[k], half[k], -1), LIGHT, ""), middle], {
      showlegend: false, margin: {l: 60, r: 8, t: 8, b: 40}, shapes: markers(x.filter((_, i) => alarm[i]), "dash", RED),
      xaxis: axis("event", {dtick: Math.ceil(x.length / 8)}), yaxis: axis(labelled(name), {nticks: 4}),
    }, {displayModeBar: false});
  });
});

figure("stages", ["kind"], (place, element) => {
  const stages = current().stages;
  element.hidden = !stages;
  if (!stages) return;
  const chain = (row, k, extra) => ({
    ...line(row.map((_, i) => i + 1), row.map(v => v > 0 ? v : null), colour(k), 1, `chain ${k}`), ...extra,
    mode: "lines+markers", marker: {size: 4},
  });
  const steps = {dtick: Math.ceil(stages.values[0].length / 10), tick0: 1};
  const right = {xaxis: "x2", yaxis: "y2", showlegend: false};
  plot(place, [...stages.values.map((row, k) => chain(row, k)), ...stages.accept.map((row, k) => chain(row, k, right))], {
    xaxis: axis("stage", {domain: [0, 0.44], ...steps}), xaxis2: axis("stage", {domain: [0.58, 1], anchor: "y2", ...steps}),
    yaxis: axis(stages.name === "beta" ? "inverse temperature [-]" : "tolerance", {type: "log", exponentformat: "power"}),
    yaxis2: axis("acceptance [-]", {range: [0, 1], anchor: "x2"}),
  });
});

figure("ranks", ["kind"], (place, element) => {
  const ranks = current().ranks || {};
  element.hidden = !current().ranks;
  smalls(place, Object.keys(ranks), (small, name) => {
    const u = unpack(ranks[name].u), half = unpack(ranks[name].half);
    const traces = ranks[name].shares.map((row, k) => line(u, unpack(row), colour(k), 1.2, `chain ${k}`));
    plot(small, [band(u, half.map(h => -h), half, "#e3e7eb", ""), ...traces], {
      showlegend: false, margin: {l: 52, r: 8, t: 8, b: 40},
      xaxis: axis(`${name}: fractional rank`, {nticks: 4}), yaxis: axis("", {nticks: 4}),
    }, {displayModeBar: false});
  });
});
