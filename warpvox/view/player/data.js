// Reads the rollout that the page carries. Positions become voxels: x to the right, y upward.

const inflate = async (text) => {
  if (!("DecompressionStream" in globalThis)) throw new Error("This browser is too old: it has no DecompressionStream.");
  const raw = atob(text.trim());
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Response(stream).arrayBuffer();
};

// Mean over neighbouring frames with bell-shaped weights: a camera that neither shakes nor lags.
const smooth = (values, width) => {
  const reach = Math.ceil(3 * width), last = values.length - 1, out = new Float32Array(values.length);
  const weights = Array.from({ length: 2 * reach + 1 }, (_, i) => Math.exp(-0.5 * ((i - reach) / width) ** 2));
  const total = weights.reduce((a, b) => a + b, 0);
  for (let k = 0; k <= last; k++) {
    let sum = 0;
    for (let i = -reach; i <= reach; i++) sum += weights[i + reach] * values[Math.min(last, Math.max(0, k + i))];
    out[k] = sum / total;
  }
  return out;
};

// Sides of voxels, once each: between two voxels (dark if both are) or on the outside.
const findSides = (scene) => {
  const seen = new Map();
  scene.objects.forEach((object) => object.corners.forEach((quad, i) => quad.forEach((a, side) => {
    const b = quad[(side + 1) % 4], key = Math.min(a, b) + " " + Math.max(a, b);
    const dark = object.cells[i] === 1 || object.cells[i] === 5;
    const known = seen.get(key);
    seen.set(key, known ? { ...known, count: known.count + 1, dark: known.dark && dark } : { a, b, count: 1, dark });
  })));
  const pick = (test) => [...seen.values()].filter(test).flatMap(({ a, b }) => [a, b]);
  scene.outer = pick((s) => s.count === 1);
  scene.inner = pick((s) => s.count > 1 && !s.dark);
  scene.innerDark = pick((s) => s.count > 1 && s.dark);
};

// Terrain as paths in voxels: runs of cells to fill, sides towards open cells to draw.
const findTerrain = (scene) => {
  const { terrain, height, width } = scene, solid = (r, c) => terrain[r]?.[c] !== undefined && terrain[r][c] !== "0";
  scene.ground = new Path2D();
  scene.surface = new Path2D();
  scene.hasGround = terrain.some((row) => /[1-9]/.test(row));
  const line = (x0, y0, x1, y1) => { scene.surface.moveTo(x0, y0); scene.surface.lineTo(x1, y1); };
  for (let r = 0; r < height; r++) {
    const top = height - r;
    for (let c = 0; c < width; c++) {
      if (!solid(r, c)) continue;
      if (r > 0 && !solid(r - 1, c)) line(c, top, c + 1, top);
      if (r < height - 1 && !solid(r + 1, c)) line(c, top - 1, c + 1, top - 1);
      if (c > 0 && !solid(r, c - 1)) line(c, top - 1, c, top);
      if (c < width - 1 && !solid(r, c + 1)) line(c + 1, top - 1, c + 1, top);
      if (!solid(r, c - 1)) {
        let end = c + 1;
        while (solid(r, end)) end++;
        scene.ground.rect(c, top - 1, end - c, 1);
      }
    }
  }
};

// The robot's smoothed centre, its height at the start, and how far it reaches from its centre however it turns.
const findTrack = (env, frames) => {
  const { robot, points } = env.scene, x = new Float32Array(frames), y = new Float32Array(frames);
  let low = Infinity, high = -Infinity, left = Infinity, right = -Infinity;
  for (let k = 0; k < frames; k++) {
    for (const p of robot) {
      const at = (k * points + p) * 2;
      x[k] += env.xy[at] / robot.length;
      y[k] += env.xy[at + 1] / robot.length;
      if (k > 0) continue;
      low = Math.min(low, env.xy[at + 1]);
      high = Math.max(high, env.xy[at + 1]);
      left = Math.min(left, env.xy[at]);
      right = Math.max(right, env.xy[at]);
    }
  }
  env.trackX = smooth(x, 9);
  env.trackY = smooth(y, 22);
  env.tall = high - low;
  env.reach = Math.hypot(high - low, right - left) / 2 + 1;
};

const readRollout = async () => {
  const meta = JSON.parse(document.getElementById("meta").textContent);
  const buffer = await inflate(document.getElementById("data").textContent);
  const { frames, scenes } = meta, steps = frames - 1;
  scenes.forEach((scene) => { findSides(scene); findTerrain(scene); });
  const rows = meta.envs.reduce((sum, env) => sum + 2 * scenes[env.scene].points, 0);
  const start = new Int32Array(buffer, 0, rows);
  const rewards = new Float32Array(buffer, rows * 4, meta.envs.length * steps);
  const bytes = new Uint8Array(buffer, (rows + meta.envs.length * steps) * 4);
  const unit = 1 / (meta.scale * meta.voxel), high = rows * steps;
  let row = 0;
  const envs = meta.envs.map((entry, number) => {
    const scene = scenes[entry.scene], width = 2 * scene.points;
    const env = { number, name: entry.name, length: entry.length, scene, xy: new Float32Array(frames * width) };
    for (let i = 0; i < width; i++, row++) {
      let value = start[row], at = row * steps;
      env.xy[i] = value * unit;
      for (let k = 1; k < frames; k++, at++) {
        value += (bytes[at] | (bytes[high + at] << 8)) << 16 >> 16;
        env.xy[k * width + i] = value * unit;
      }
    }
    env.rewards = rewards.subarray(number * steps, (number + 1) * steps);
    env.returns = new Float64Array(frames);
    for (let k = 0; k < steps; k++) env.returns[k + 1] = env.returns[k] + env.rewards[k];
    findTrack(env, frames);
    return env;
  });
  return { meta, envs };
};
