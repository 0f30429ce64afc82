// What is drawn: a grid of cells, each of a type and of an object; row 0 on top. Nothing here knows about the page.

class Drawing {
  constructor(kind, names, width, height) {
    Object.assign(this, { kind, names: [...names], width, height });
    this.types = new Int8Array(width * height);
    this.owners = new Int16Array(width * height);
  }

  static from({ kind, names, types, owners }) {
    const drawing = new Drawing(kind, names, types[0].length, types.length);
    drawing.types.set(types.flat());
    drawing.owners.set(owners.flat());
    return drawing;
  }

  // A world to begin with: a floor, and a body that stands on it.
  static worldWith(body) {
    const width = Math.max(24, body.width + 12), height = Math.max(10, body.height + 4);
    const world = new Drawing("world", ["ground", "robot"], width, height);
    for (let x = 0; x < width; x++) world.set(x, height - 1, 5, 0);
    for (let y = 0; y < body.height; y++) {
      for (let x = 0; x < body.width; x++) {
        world.set(x + 2, height - 1 - body.height + y, body.types[y * body.width + x], 1);
      }
    }
    return world;
  }

  rows(values) {
    return Array.from({ length: this.height }, (_, y) => [...values.subarray(y * this.width, (y + 1) * this.width)]);
  }

  toDocument() {
    return { kind: this.kind, names: this.names, types: this.rows(this.types), owners: this.rows(this.owners) };
  }

  copy() {
    const other = new Drawing(this.kind, this.names, this.width, this.height);
    other.types.set(this.types);
    other.owners.set(this.owners);
    return other;
  }

  has(x, y) { return x >= 0 && y >= 0 && x < this.width && y < this.height; }
  type(x, y) { return this.has(x, y) ? this.types[y * this.width + x] : 0; }
  owner(x, y) { return this.type(x, y) ? this.owners[y * this.width + x] : -1; }

  set(x, y, type, owner) {
    if (!this.has(x, y)) return;
    this.types[y * this.width + x] = type;
    this.owners[y * this.width + x] = type ? owner : 0;
  }

  // Another size; what is drawn keeps its distance to the lower left corner, as on a floor.
  resized(width, height) {
    const other = new Drawing(this.kind, this.names, width, height), shift = height - this.height;
    for (let y = 0; y < this.height; y++) {
      for (let x = 0; x < this.width; x++) other.set(x, y + shift, this.type(x, y), this.owner(x, y));
    }
    return other;
  }

  // Without an object and its cells.
  without(number) {
    const other = this.copy();
    other.names.splice(number, 1);
    for (let i = 0; i < other.types.length; i++) {
      if (other.types[i] && other.owners[i] === number) other.types[i] = other.owners[i] = 0;
      else if (other.owners[i] > number) other.owners[i]--;
    }
    return other;
  }
}

// Cells on the straight way from one to another, both included.
const cellsBetween = (a, b) => {
  const steps = Math.max(Math.abs(b.x - a.x), Math.abs(b.y - a.y), 1);
  return Array.from({ length: steps + 1 }, (_, k) => ({
    x: Math.round(a.x + ((b.x - a.x) * k) / steps), y: Math.round(a.y + ((b.y - a.y) * k) / steps),
  }));
};

const cellsWithin = (a, b) => {
  const cells = [];
  for (let y = Math.min(a.y, b.y); y <= Math.max(a.y, b.y); y++) {
    for (let x = Math.min(a.x, b.x); x <= Math.max(a.x, b.x); x++) cells.push({ x, y });
  }
  return cells;
};

// Drawings before and after the present one.
class History {
  constructor() { this.past = []; this.future = []; }

  keep(drawing) {
    this.past.push(drawing);
    if (this.past.length > 200) this.past.shift();
    this.future = [];
  }

  back(present) {
    if (!this.past.length) return present;
    this.future.push(present);
    return this.past.pop();
  }

  forth(present) {
    if (!this.future.length) return present;
    this.past.push(present);
    return this.future.pop();
  }
}
