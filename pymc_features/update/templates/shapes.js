// Mode shapes of the model on a canvas: turned by a finger or the mouse, moving, with draws as ghosts.
// One scene of polygons, lines and dots is drawn on the canvas, and written as SVG for the picture.
const view = {yaw: -0.65, pitch: 0.32, phase: Math.PI / 2, plays: !matchMedia("(prefers-reduced-motion: reduce)").matches};

// Nodes of the geometry: points at the same place are one node that moves in all their directions.
const solid = payload.geometry && (() => {
  const {place, direction, lines, style, sensors} = payload.geometry;
  const keys = place.map(String), unique = [...new Set(keys)], node = keys.map(key => unique.indexOf(key));
  const places = unique.map(key => place[keys.indexOf(key)]);
  const ends = [0, 1, 2].map(axis => [Math.min(...places.map(p => p[axis])), Math.max(...places.map(p => p[axis]))]);
  if (style !== "nodes") ends[2][0] = 0;  // the ground
  const size = Math.max(...ends.map(([low, high]) => high - low), 1e-9), isBuilding = style === "storeys";
  const floor = isBuilding ? Math.max(0.16 * size, Math.min(0.3 * size, 1.2)) : 0;
  return {
    node, places, direction, style, sensors, size, isBuilding, lines: lines.map(row => row.map(k => node[k])),
    radius: 0.05 * size + Math.hypot(...ends.map(([low, high], axis) => 0.5 * (high - low) + (axis < 2 ? floor : 0))),
    middle: ends.map(([low, high]) => 0.5 * (low + high)), floor,
  };
})();

// Places of the nodes under a shape, an entry for each point.
function moved(shape, scale) {
  const found = solid.places.map(p => [...p]);
  shape.forEach((entry, k) => solid.direction[k].forEach((d, axis) => { found[solid.node[k]][axis] += (entry || 0) * scale * d; }));
  return found;
}

function projector(width, height) {
  const zoom = 0.47 * Math.min(height, width) / solid.radius;
  const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
  return p => {
    const [x, y, z] = p.map((v, axis) => v - solid.middle[axis]);
    const across = x * cy - y * sy, into = x * sy + y * cy;
    return [width / 2 + zoom * across, height / 2 - zoom * (z * cp - into * sp), into * cp + z * sp];
  };
}

const rectangle = ([x, y, z], half) => [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => [x + a * half, y + b * half, z]);

// The parts of one deformed structure.
function parts(places, {fill, stroke, width, columns}) {
  if (solid.isBuilding) {
    const floors = [[0, 0, 0], ...places].map(p => rectangle(p, solid.floor));
    return floors.flatMap((corners, k) => [
      ...(k || fill ? [{points: corners, closed: true, fill, stroke, width}] : []),
      ...corners.slice(k && columns ? 0 : 4).map((corner, c) => ({points: [floors[k - 1][c], corner], stroke, width: 1.5 * width})),
    ]);
  }
  const dots = columns ? places.map(p => ({points: [p], fill: stroke, radius: places.length > 60 ? 1.6 : 3})) : [];
  return [...solid.lines.map(row => ({points: row.map(k => places[k]), stroke, width: 1.4 * width})), ...dots];
}

// What is seen at a moment, sorted from the back to the front.
function scene(width, height) {
  const {shapes, identified} = current().modes, all = unpack(shapes), k = chosen.mode, project = projector(width, height);
  const scale = 0.17 * solid.size * Number($("amplitude").value), now = scale * Math.sin(view.phase);
  const places = moved(all[0][k], now), draws = $("ghosts").checked ? all.slice(1) : [];
  const dot = (at, fill, radius) => ({points: [at], fill, radius, front: true});
  const found = [
    ...parts(solid.places, {stroke: "#c5ccd4", width: 0.8, columns: true}),
    ...draws.flatMap(draw => parts(moved(draw[k], now), {stroke: "rgba(37,99,168,0.22)", width: 0.8})),
    ...parts(places, {stroke: BLUE, fill: "rgba(37,99,168,0.30)", width: 1.2, columns: true}),
    ...Object.values(solid.sensors).map(point => dot(places[solid.node[point]], INK, 3.5)),
  ];
  const which = identified ? identified.partners.indexOf(k + 1) : -1;
  if (which >= 0) {  // scaled by the factor that brings it closest to the model
    const {points, shapes: rows} = identified, known = points.map((p, i) => [p, rows[which][i]]).filter(([, v]) => v !== null);
    const factor = known.reduce((sum, [p, v]) => sum + v * all[0][k][p], 0) / known.reduce((sum, [, v]) => sum + v * v, 0);
    const entries = new Array(all[0][k].length).fill(0);
    known.forEach(([p, v]) => { entries[p] = v * factor; });
    const measured = moved(entries, now);
    new Set(known.map(([p]) => solid.node[p])).forEach(n => found.push(
      {points: [solid.places[n], measured[n]], stroke: RED, width: 1.4, front: true}, dot(measured[n], RED, 5.5)));
  }
  found.forEach(part => {
    part.at = part.points.map(project);
    part.depth = part.front ? -1e9 : part.at.reduce((sum, p) => sum + p[2], 0) / part.at.length;
  });
  return found.sort((a, b) => b.depth - a.depth);
}

function paint(canvas) {
  const {clientWidth: width, clientHeight: height} = canvas, ratio = devicePixelRatio || 1;
  if (!width) return;
  const size = [width, height].map(length => Math.round(length * ratio));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.fillStyle = "#fff"; pen.fillRect(0, 0, width, height);
  pen.lineJoin = "round";
  for (const {at, fill, stroke, width: thick, radius, closed} of scene(width, height)) {
    pen.beginPath();
    if (radius) pen.arc(at[0][0], at[0][1], radius, 0, 7);
    else at.forEach(([x, y], i) => i ? pen.lineTo(x, y) : pen.moveTo(x, y));
    if (closed) pen.closePath();
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    if (stroke) { pen.strokeStyle = stroke; pen.lineWidth = thick; pen.stroke(); }
  }
}

function asSvg(width, height) {
  const shape = ({at, fill, stroke, width: thick, radius, closed}) => {
    const style = `fill="${fill || "none"}" stroke="${stroke || "none"}" stroke-width="${thick || 0}"`;
    if (radius) return `<circle cx="${at[0][0].toFixed(1)}" cy="${at[0][1].toFixed(1)}" r="${radius}" ${style}/>`;
    const points = at.map(p => `${p[0].toFixed(1)},${p[1].toFixed(1)}`).join(" ");
    return `<poly${closed ? "gon" : "line"} points="${points}" ${style}/>`;
  };
  const inside = scene(width, height).map(shape).join("\n");
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}">${inside}</svg>`;
}

figure("shapes", ["kind", "mode"], (place, element) => {
  const {identified} = current().modes, k = chosen.mode, texts = current().frequency_texts[k];
  const which = identified ? identified.partners.indexOf(k + 1) : -1;
  const red = which < 0 ? "" : `Red is the identified mode ${identified.names[which]} at `
    + `${identified.frequencies[which]} Hz, with a MAC of ${identified.mac[which][k].toFixed(3)}. `;
  element.querySelector("figcaption").textContent =
    `Mode ${k + 1} under ${chosen.kind} has ${texts[1]} Hz, and with a probability of 90 % from ${texts[0]} to `
    + `${texts[2]} Hz. ${red}Blue is the draw nearest to the medians, thin lines are other draws, and black dots `
    + "are the measured places. Drag to turn it."
    + (solid.style === "entries" ? " Entries of the shape stand along the numbers of their degrees of freedom." : "");
  if (place.firstChild) { paint(place.firstChild); return; }
  const canvas = document.createElement("canvas");
  place.append(canvas);
  let seen = true, last = null;
  new IntersectionObserver(([entry]) => { seen = entry.isIntersecting; }).observe(canvas);
  canvas.onpointerdown = event => { last = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); };
  canvas.onpointermove = event => {
    if (!last) return;
    view.yaw += 0.01 * (event.clientX - last[0]);
    view.pitch = Math.max(-1.5, Math.min(1.5, view.pitch + 0.01 * (event.clientY - last[1])));
    last = [event.clientX, event.clientY];
    paint(canvas);
  };
  canvas.onpointerup = canvas.onpointercancel = () => { last = null; };
  const label = () => { $("play").textContent = view.plays ? "Pause" : "Play"; };
  $("play").onclick = () => { view.plays = !view.plays; label(); };
  $("ghosts").onchange = $("amplitude").oninput = () => paint(canvas);
  label();
  let before = 0;
  const step = now => {
    const passed = Math.min(now - before, 100) / 1000;
    before = now;
    if (seen && (view.plays || $("turn").checked)) {
      if (view.plays) view.phase += 2.6 * passed;
      if ($("turn").checked) view.yaw += 0.4 * passed;
      paint(canvas);
    }
    requestAnimationFrame(step);
  };
  new ResizeObserver(() => paint(canvas)).observe(canvas);
  requestAnimationFrame(step);
}, {
  picture(format, name) {
    const canvas = document.querySelector('[data-figure="shapes"] canvas');
    if (format === "png") download(`${name}.png`, canvas.toDataURL("image/png"));
    else download(`${name}.svg`, blobOf(asSvg(canvas.clientWidth, canvas.clientHeight), "image/svg+xml"));
  },
});
