// The stage: panels of meshes side by side or overlaid, their names, and the legend of the colours.
"use strict";

/**
 * Make a stage in the elements of the page. `panels(items, camera, state)` returns the panels for the renderer, without
 * their meshes; `placeNames` draws the names, `legend` the meaning of the colours.
 */
var mixseqStage = function (stage, names, legendElement) {
  const NAME_HEIGHT = 34, LEGEND_HEIGHT = 52, MARGIN = 0.05;
  const TINTS = [[1, 1, 1], [0.72, 0.92, 1.16], [0.8, 1.1, 0.8], [1.08, 0.86, 1.12], [1.12, 1.02, 0.7]];

  const MEANINGS = { parts: "One colour per rigid part, paler in joints, red where parts meet", own: "Vertex colours" };

  /** RGB factors that distinguish overlaid meshes of clay. */
  const tint = (number, overlaid) => (overlaid ? TINTS[number % TINTS.length] : TINTS[0]);

  /** Union of extents, with its centre as the camera's target; `view` is 0 for their own views, 1 for that of the first item. */
  function union(extents, view) {
    const low = [0, 1, 2].map((k) => Math.min(...extents.map((extent) => extent.low[k])));
    const high = [0, 1, 2].map((k) => Math.max(...extents.map((extent) => extent.high[k])));
    const seen = [Math.min, Math.max, Math.min, Math.max].map((nearest, k) => nearest(...extents.map((extent) => extent.seen[view][k])));
    return { low, high, seen, target: low.map((value, k) => (value + high[k]) / 2) };
  }

  /** Divide the stage into boxes, with the number of columns that draws the meshes largest. */
  function boxes(count, width, height, aspect) {
    let best = null;
    for (let columns = 1; columns <= count; columns++) {
      const rows = Math.ceil(count / columns), across = width / columns, down = height / rows;
      const size = Math.min(across, Math.max(down - NAME_HEIGHT, 1) * aspect);
      if (!best || size > best.size * 1.001) best = { columns, across, down, size };
    }
    return Array.from({ length: count }, (_, k) => {
      const row = Math.floor(k / best.columns), inRow = Math.min(best.columns, count - row * best.columns);
      const indent = ((best.columns - inRow) * best.across) / 2; // an incomplete last row is centred
      return [indent + (k % best.columns) * best.across, row * best.down, best.across, best.down];
    });
  }

  function panels(items, camera, { overlaid, following }) {
    const view = overlaid ? 1 : 0, first = items[0], hasLegend = legendElement.dataset.wanted === "true";
    const extents = (group) => group.map((item) => (following ? item.following : item.still));
    const together = overlaid ? [items] : items.map((item) => (item.likeFirst ? items.filter((other) => other.likeFirst) : [item]));
    const below = hasLegend ? LEGEND_HEIGHT : 0, frames = together.map((group) => ({ ...union(extents(group), view), ...viewOf(overlaid ? first : group[0]) }));
    const sizes = frames.map(pictureSize), width = stage.clientWidth, height = stage.clientHeight - below;
    const aspect = sizes.map((size) => size[0] / size[1]).sort((a, b) => a - b)[sizes.length >> 1];
    return boxes(frames.length, width, height, aspect).map(([left, top, across, down], k) => {
      const last = top + down > height - 1; // the ground continues under the legend
      const room = [left, top + NAME_HEIGHT, across, down - NAME_HEIGHT];
      return panel(frames[k], sizes[k], [left, top, across, last ? down + below : down], room, camera);
    });
  }

  const viewOf = ({ azimuth, elevation }) => ({ azimuth, elevation });

  /** Width and height of the meshes in the initial view and in any other azimuth. */
  function pictureSize({ low, high, seen }) {
    const across = Math.max(seen[1] - seen[0], Math.hypot(high[0] - low[0], high[2] - low[2]));
    const larger = Math.max(across, seen[3] - seen[2]) || 1;
    return [Math.max(across, 0.2 * larger), Math.max(seen[3] - seen[2], 0.2 * larger)];
  }

  function panel({ low, high, seen, target, azimuth, elevation }, size, box, room, camera) {
    const [, , width, height] = room, centre = (rectangle) => rectangle[1] + rectangle[3] / 2;
    const fit = (1 - 2 * MARGIN) * Math.min(width / size[0], Math.max(height, 1) / size[1]);
    // the meshes of the initial view are centred in the space below the name
    const first = mixseqRotation(azimuth, elevation).map((row) => row[0] * target[0] + row[1] * target[1] + row[2] * target[2]);
    const scale = fit * camera.zoom, aside = (seen[0] + seen[1]) / 2 - first[0], above = (seen[2] + seen[3]) / 2 - first[1];
    const shift = [camera.pan[0] - aside * scale, camera.pan[1] + above * scale + (centre(room) - centre(box)) * camera.zoom];
    const rows = camera.rotation(azimuth, elevation), sides = high.map((value, k) => value - low[k]);
    const largest = Math.max(...sides) || 1;
    return { box, rows, target, scale, shift, ground: low[1], size: largest, reach: 0.6 * Math.max(sides[0], sides[2]) + 0.08 * largest };
  }

  /** Draw the names above the panels; overlaid meshes share a panel. */
  function placeNames(items, panels, overlaid, tinted) {
    names.replaceChildren(...panels.map(({ box }, k) => {
      const name = document.createElement("div");
      name.className = "name";
      Object.assign(name.style, { left: `${box[0]}px`, top: `${box[1] + 10}px`, width: `${box[2]}px` });
      if (!overlaid) name.textContent = name.title = items[k].name;
      else items.forEach((item, number) => name.append(chip(item, number, tinted)));
      return name;
    }));
  }

  /** Name of an overlaid mesh, with its tint if it has one. */
  function chip(item, number, tinted) {
    const text = document.createElement("span");
    if (tinted) {
      const colour = item.colourings[0].palette[0].map((value, k) => Math.min(value * TINTS[number % TINTS.length][k], 255));
      const square = text.appendChild(document.createElement("i"));
      square.style.background = `rgb(${colour.map(Math.round).join(",")})`;
    }
    text.append(item.name);
    return text;
  }

  /** Show the meaning of the colours, except for clay. */
  function legend(colouring) {
    const [name, scale] = legendElement.children, [bar, numbers] = scale.children;
    legendElement.hidden = !colouring || colouring.name === "clay";
    if (legendElement.hidden) return;
    const { low, top } = colouring;
    scale.hidden = top === undefined;
    name.textContent = scale.hidden ? MEANINGS[colouring.name] ?? colouring.name : label(colouring);
    if (scale.hidden) return;
    bar.style.background = `linear-gradient(90deg, ${colouring.palette.map((rgb) => "rgb(" + rgb.join(",") + ")").join(",")})`;
    [low, (low + top) / 2, top].forEach((value, k) => (numbers.children[k].textContent = `${+value.toPrecision(3)}`));
  }

  const label = ({ name, unit }) => mixseqCapital(name) + (unit ? ` (${unit})` : "");

  return { panels, placeNames, legend, tint };
};

var mixseqCapital = (name) => name.charAt(0).toUpperCase() + name.slice(1);
