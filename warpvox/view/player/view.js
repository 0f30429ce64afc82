// Draws environments on a canvas.

const BELOW = 1.25, ANCHOR = 0.42, SHADES = 33;

// Colours of a cell type from contracted to extended, ready for the canvas.
const makeShades = (ramp) => Array.from({ length: SHADES }, (_, i) => {
  const t = (2 * i) / (SHADES - 1) - 1, from = ramp[1], to = t < 0 ? ramp[0] : ramp[2];
  return `rgb(${from.map((value, c) => Math.round(value + (to[c] - value) * Math.abs(t))).join(",")})`;
});

const makeColours = (meta) => {
  const shades = Object.fromEntries(Object.entries(meta.colours).map(([cell, ramp]) => [cell, makeShades(ramp)]));
  const [low, high] = meta.limits;
  return (cell, stretch) => {
    const t = stretch < 1 ? (stretch - 1) / (1 - low) : (stretch - 1) / (high - 1);
    return shades[cell][Math.round((Math.min(1, Math.max(-1, t)) + 1) / 2 * (SHADES - 1))];
  };
};

const readTheme = () => {
  const style = getComputedStyle(document.documentElement);
  return new Proxy({}, { get: (cache, name) => (cache[name] ??= style.getPropertyValue("--" + name).trim()) });
};

// Points of an environment at a time between frames, as [x, y, x, y, ...] in voxels.
const pointsAt = (env, time, out) => {
  const width = env.scene.points * 2, frames = env.returns.length;
  const k = Math.min(frames - 1, Math.floor(time)), next = Math.min(frames - 1, k + 1), part = time - k;
  for (let i = 0, a = k * width, b = next * width; i < width; i++) {
    out[i] = env.xy[a + i] + part * (env.xy[b + i] - env.xy[a + i]);
  }
  return out;
};

const valueAt = (values, time) => {
  const k = Math.floor(time), next = Math.min(values.length - 1, k + 1);
  return values[k] + (time - k) * (values[next] - values[k]);
};

// Length of a cell against rest along the axis that its actuator drives (others: mean of both).
const stretchOf = (xy, quad, cell) => {
  const side = (i, j) => Math.hypot(xy[2 * quad[i]] - xy[2 * quad[j]], xy[2 * quad[i] + 1] - xy[2 * quad[j] + 1]);
  const across = (side(0, 1) + side(2, 3)) / 2, upright = (side(1, 2) + side(3, 0)) / 2;
  return cell === 3 ? across : cell === 4 ? upright : (across + upright) / 2;
};

// Which part of the world a box shows. pan: where the camera stands if it does not follow.
const lookAt = (env, time, box, zoom, pan) => {
  const scale = zoom * Math.min(box.h / Math.max(12, 2.4 * env.tall), box.w / 12), w = box.w / scale, h = box.h / scale;
  if (pan) return { scale, left: pan.x - w / 2, bottom: pan.y - h / 2, w, h };
  const x = valueAt(env.trackX, time), y = valueAt(env.trackY, time), { width } = env.scene;
  const left = w > width + 2 * BELOW ? (width - w) / 2 : Math.min(width + BELOW - w, Math.max(-BELOW, x - w / 2));
  const beside = Math.min(env.reach, w / 2), above = Math.min(env.reach, h / 2);
  return {
    scale, w, h,
    left: Math.min(x - beside, Math.max(x + beside - w, left)),
    bottom: Math.min(y - above, Math.max(y + above - h, Math.max(-BELOW, y - ANCHOR * h))),
  };
};

const drawWorld = (g, env, look, theme, pixel) => {
  const { scene } = env, { left, bottom, w, h, scale } = look, right = left + w, top = bottom + h;
  g.fillStyle = theme.beyond;
  g.fillRect(left, bottom, w, h);
  const x0 = Math.max(0, left), x1 = Math.min(scene.width, right), y0 = Math.max(0, bottom);
  g.fillStyle = theme.sky;
  if (x1 > x0 && top > y0) g.fillRect(x0, y0, x1 - x0, top - y0);
  const rule = (every, colour) => {
    g.beginPath();
    for (let x = Math.ceil(x0 / every) * every; x <= x1; x += every) { g.moveTo(x, y0); g.lineTo(x, top); }
    for (let y = Math.ceil(y0 / every) * every; y <= top; y += every) { g.moveTo(x0, y); g.lineTo(x1, y); }
    g.strokeStyle = colour;
    g.lineWidth = pixel;
    g.stroke();
  };
  if (scale > 9) rule(1, theme.grid);
  if (scale > 2) rule(10, theme["grid-strong"]);
  if (!scene.hasGround) return;
  g.fillStyle = theme.ground;
  g.fill(scene.ground);
  if (scale > 9) {
    g.save();
    g.clip(scene.ground);
    rule(1, theme["ground-line"]);
    g.restore();
  }
  g.strokeStyle = theme["ground-edge"];
  g.lineWidth = Math.max(pixel, 0.07);
  g.stroke(scene.surface);
};

const drawCells = (g, env, xy, look, colourOf, theme, pixel) => {
  const left = look.left - 2, right = look.left + look.w + 2, low = look.bottom - 2, high = look.bottom + look.h + 2;
  // Bridges and heaps are larger than the picture: what lies outside costs nothing.
  const seen = (p) => xy[2 * p] > left && xy[2 * p] < right && xy[2 * p + 1] > low && xy[2 * p + 1] < high;
  const trace = (pairs) => {
    g.beginPath();
    for (let i = 0; i < pairs.length; i += 2) {
      const a = pairs[i], b = pairs[i + 1];
      if (!seen(a)) continue;
      g.moveTo(xy[2 * a], xy[2 * a + 1]);
      g.lineTo(xy[2 * b], xy[2 * b + 1]);
    }
  };
  // Cells of one colour make one path: fewer calls, and no seams between them.
  const byColour = new Map();
  for (const { cells, corners } of env.scene.objects) {
    for (let i = 0; i < cells.length; i++) {
      const cell = cells[i], quad = corners[i];
      if (!seen(quad[0])) continue;
      const colour = colourOf(cell, cell === 3 || cell === 4 ? stretchOf(xy, quad, cell) : 1);
      const quads = byColour.get(colour);
      if (quads) quads.push(quad); else byColour.set(colour, [quad]);
    }
  }
  for (const [colour, quads] of byColour) {
    g.beginPath();
    for (const quad of quads) {
      g.moveTo(xy[2 * quad[0]], xy[2 * quad[0] + 1]);
      for (let c = 1; c < 4; c++) g.lineTo(xy[2 * quad[c]], xy[2 * quad[c] + 1]);
      g.closePath();
    }
    g.fillStyle = colour;
    g.fill();
  }
  if (pixel < 0.2) {
    g.lineWidth = Math.max(0.6 * pixel, 0.032);
    for (const [pairs, colour] of [[env.scene.innerDark, theme["ink-dark"]], [env.scene.inner, theme["ink-inner"]]]) {
      g.strokeStyle = colour;
      trace(pairs);
      g.stroke();
    }
  }
  g.strokeStyle = theme.ink;
  g.lineWidth = Math.max(pixel, 0.055);
  trace(env.scene.outer);
  g.stroke();
};

const drawRuler = (g, env, box, look, theme) => {
  const size = Math.min(15, look.scale * 0.42), y = box.y + box.h - (-BELOW / 2 - look.bottom) * look.scale;
  if (size < 8 || y > box.y + box.h || y < box.y) return;
  g.fillStyle = theme["beyond-ink"];
  g.font = `${size}px system-ui, sans-serif`;
  g.textAlign = "center";
  g.textBaseline = "middle";
  for (let x = Math.max(0, Math.ceil(look.left / 10) * 10); x <= Math.min(env.scene.width, look.left + look.w); x += 10) {
    g.fillText(x, box.x + (x - look.left) * look.scale, y);
  }
};

const drawLabel = (g, env, box, time, theme, chosen) => {
  const size = Math.max(9, Math.min(13, box.h / 12)), ended = time >= env.length && env.length < env.returns.length - 1;
  const text = `${env.name}   ${env.returns[Math.floor(time)].toFixed(2)}${ended ? "   ended" : ""}`;
  g.font = `${size}px system-ui, sans-serif`;
  g.textAlign = "left";
  g.textBaseline = "middle";
  g.fillStyle = theme.panel;
  g.beginPath();
  g.roundRect(box.x + 4, box.y + 4, g.measureText(text).width + size * 1.2, size * 1.8, size / 2);
  g.fill();
  g.fillStyle = chosen ? theme.accent : theme.text;
  g.fillText(text, box.x + 4 + size * 0.6, box.y + 4 + size * 0.92);
};

// One environment in its box (in CSS pixels); ratio: device pixels to a CSS pixel.
const drawEnv = (g, env, time, box, look, style, ratio) => {
  const { theme, colourOf, buffer } = style, pixel = 1 / look.scale;
  const xy = pointsAt(env, time, buffer);
  g.save();
  g.beginPath();
  g.rect(box.x, box.y, box.w, box.h);
  g.clip();
  g.setTransform(
    ratio * look.scale, 0, 0, -ratio * look.scale,
    ratio * (box.x - look.left * look.scale), ratio * (box.y + box.h + look.bottom * look.scale),
  );
  g.lineCap = g.lineJoin = "round";
  drawWorld(g, env, look, theme, pixel);
  drawCells(g, env, xy, look, colourOf, theme, pixel);
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawRuler(g, env, box, look, theme);
  g.restore();
};

// The cell that contains a point of the world, or null; later objects lie above earlier ones.
const cellAt = (env, time, x, y, buffer) => {
  const xy = pointsAt(env, time, buffer);
  for (const object of [...env.scene.objects].reverse()) {
    for (let i = 0; i < object.cells.length; i++) {
      const quad = object.corners[i];
      let inside = false;
      for (let a = 0, b = 3; a < 4; b = a++) {
        const ax = xy[2 * quad[a]], ay = xy[2 * quad[a] + 1], bx = xy[2 * quad[b]], by = xy[2 * quad[b] + 1];
        if (ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax) inside = !inside;
      }
      if (inside) {
        const [row, column] = object.places[i];
        return { object: object.name, cell: object.cells[i], row, column, stretch: stretchOf(xy, quad, object.cells[i]) };
      }
    }
  }
  return null;
};

// Returns of all environments over time, that of the chosen one strong. Painted on a canvas of its own, because it
// changes with the choice, the theme and the size only.
const drawCurves = (g, envs, chosen, box, theme) => {
  const frames = envs[0].returns.length, last = Math.max(1, frames - 1);
  const stride = Math.max(1, Math.floor(last / (2 * box.w)));
  const curve = (env, colour, width) => {
    g.beginPath();
    for (let k = 0; k <= last && k < frames; k += stride) g.lineTo(box.toX(k), box.toY(env.returns[k]));
    g.strokeStyle = colour;
    g.lineWidth = width;
    g.stroke();
  };
  g.fillStyle = theme["grid-strong"];
  g.fillRect(0, box.toY(0), box.w, 1);
  g.lineJoin = "round";
  for (const env of envs) if (env !== chosen) curve(env, theme["curve-other"], 1.5);
  curve(chosen, theme.curve, 2);
  g.font = "11px system-ui, sans-serif";
  const rises = chosen.returns[last] > chosen.returns[0]; // the figures stand in the corners that the curve leaves free
  const figures = [[`return ${box.high.toFixed(2)}`, 4, "top", rises], [box.low.toFixed(2), box.h - 4, "bottom", !rises]];
  for (const [text, y, side, left] of figures) {
    const x = left ? 6 : box.w - 6;
    g.textBaseline = side;
    g.textAlign = left ? "left" : "right";
    g.strokeStyle = theme.press;
    g.lineWidth = 4; // a halo keeps the figures legible where curves cross them
    g.strokeText(text, x, y);
    g.fillStyle = theme.faint;
    g.fillText(text, x, y);
  }
};

class Timeline {
  constructor(envs) {
    this.envs = envs;
    this.low = this.high = 0;
    for (const env of envs) for (const value of env.returns) this.include(value);
    if (this.high - this.low < 1e-9) this.high = this.low + 1;
    this.curves = document.createElement("canvas");
  }

  include(value) {
    this.low = Math.min(this.low, value);
    this.high = Math.max(this.high, value);
  }

  draw({ g, w, h, ratio }, chosen, time, theme) {
    const last = Math.max(1, chosen.returns.length - 1), pad = 8, { low, high } = this;
    const toX = (k) => (k / last) * w, toY = (value) => h - pad - ((value - low) / (high - low)) * (h - 2 * pad);
    if (this.chosen !== chosen || this.theme !== theme || this.w !== w || this.h !== h || this.ratio !== ratio) {
      Object.assign(this, { chosen, theme, w, h, ratio });
      Object.assign(this.curves, { width: Math.max(1, w * ratio), height: Math.max(1, h * ratio) });
      const own = this.curves.getContext("2d");
      own.setTransform(ratio, 0, 0, ratio, 0, 0);
      drawCurves(own, this.envs, chosen, { w, h, low, high, toX, toY }, theme);
    }
    g.fillStyle = theme.press;
    g.fillRect(0, 0, w, h);
    g.fillStyle = theme.line;
    g.fillRect(0, 0, toX(time), h);
    g.drawImage(this.curves, 0, 0, w, h);
    g.fillStyle = theme.text;
    g.fillRect(toX(time) - 1, 0, 2, h);
    g.beginPath();
    g.arc(toX(time), toY(valueAt(chosen.returns, time)), 4, 0, 7);
    g.fillStyle = theme.curve;
    g.fill();
  }
}
