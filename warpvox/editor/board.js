// The grid on a canvas: shows a drawing and turns pointer and arrow keys into strokes.

class Board {
  // onStroke(cells, erase, begins) paints; onEnd() follows when the button is let go.
  constructor(canvas, { onStroke, onEnd }) {
    Object.assign(this, { canvas, onStroke, onEnd, cursor: null, from: null, last: null, box: null });
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.release(event));
    canvas.addEventListener("pointercancel", () => this.cancel());
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("blur", () => { this.cursor = null; this.redraw(); });
  }

  cellAt(event) {
    const box = this.canvas.getBoundingClientRect();
    return { x: Math.floor((event.clientX - box.left) / this.size), y: Math.floor((event.clientY - box.top) / this.size) };
  }

  press(event) {
    if (event.button !== 0 && event.button !== 2) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.cursor = null;
    this.erase = event.button === 2;
    this.from = this.last = this.cellAt(event);
    this.rectangle = event.shiftKey;
    if (this.rectangle) { this.box = [this.from, this.from]; this.redraw(); return; }
    this.onStroke([this.from], this.erase, true);
  }

  move(event) {
    if (!this.from) return;
    const cell = this.cellAt(event);
    if (cell.x === this.last.x && cell.y === this.last.y) return;
    if (this.rectangle) { this.box = [this.from, cell]; this.redraw(); }
    else this.onStroke(cellsBetween(this.last, cell), this.erase, false);
    this.last = cell;
  }

  release() {
    if (!this.from) return;
    if (this.rectangle) this.onStroke(cellsWithin(...this.box), this.erase, true);
    this.from = this.box = null;
    this.onEnd();
  }

  cancel() {
    if (this.from) { this.from = this.box = null; this.onEnd(); }
  }

  // Arrow keys move a cursor, Enter paints there, Delete erases. Whether the key was one of these.
  key(key) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (!(key in steps) && key !== "Enter" && key !== "Delete") return false;
    const { width, height } = this.drawing;
    this.cursor ??= { x: 0, y: 0 };
    if (key in steps) {
      const [dx, dy] = steps[key];
      this.cursor = {
        x: Math.min(width - 1, Math.max(0, this.cursor.x + dx)), y: Math.min(height - 1, Math.max(0, this.cursor.y + dy)),
      };
      this.redraw();
    } else {
      this.onStroke([this.cursor], key === "Delete", true);
      this.onEnd();
    }
    return true;
  }

  show(drawing, active, style) {
    Object.assign(this, { drawing, active, style });
    const room = this.canvas.parentElement, { width, height } = drawing;
    const fit = Math.min((room.clientWidth - 32) / width, (room.clientHeight - 32) / height);
    this.size = Math.floor(Math.min(64, Math.max(14, fit)));
    this.redraw();
  }

  redraw() {
    if (!this.drawing) return;
    const { canvas, drawing, size, style } = this, { width, height } = drawing, ratio = devicePixelRatio || 1;
    canvas.style.width = `${width * size}px`;
    canvas.style.height = `${height * size}px`;
    canvas.width = width * size * ratio;
    canvas.height = height * size * ratio;
    const g = canvas.getContext("2d");
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.drawGrid(g);
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) {
        if (!drawing.type(x, y)) continue;
        g.fillStyle = style.colours[drawing.type(x, y)];
        g.fillRect(x * size, y * size, size, size);
      }
    }
    this.drawEdges(g);
    this.drawMarks(g);
  }

  drawGrid(g) {
    const { drawing: { width, height }, size, style } = this;
    const line = (strong, ...ends) => {
      g.strokeStyle = strong ? style.theme("grid-strong") : style.theme("grid");
      g.lineWidth = 1;
      g.beginPath();
      g.moveTo(ends[0], ends[1]);
      g.lineTo(ends[2], ends[3]);
      g.stroke();
    };
    for (let x = 1; x < width; x++) line(x % 10 === 0, x * size, 0, x * size, height * size);
    for (let y = 1; y < height; y++) line((height - y) % 10 === 0, 0, y * size, width * size, y * size);
  }

  // Thin lines between cells of one object, thick ones around it: what touches without belonging together shows.
  drawEdges(g) {
    const { drawing, size, style, active } = this;
    const trace = (test, colour, width) => {
      g.beginPath();
      for (let y = 0; y <= drawing.height; y++) {
        for (let x = 0; x <= drawing.width; x++) {
          const own = drawing.owner(x, y);
          if (test(own, drawing.owner(x - 1, y))) { g.moveTo(x * size, y * size); g.lineTo(x * size, (y + 1) * size); }
          if (test(own, drawing.owner(x, y - 1))) { g.moveTo(x * size, y * size); g.lineTo((x + 1) * size, y * size); }
        }
      }
      g.strokeStyle = colour;
      g.lineWidth = width;
      g.lineCap = "round";
      g.stroke();
    };
    trace((a, b) => a >= 0 && a === b, style.theme("ink-inner"), 1);
    trace((a, b) => a !== b, style.theme("ink"), 2);
    if (drawing.kind === "world") trace((a, b) => a !== b && (a === active || b === active), style.theme("accent"), 3);
  }

  drawMarks(g) {
    const { size, style, box, cursor } = this;
    const [a, b] = box ?? (cursor ? [cursor, cursor] : []);
    if (!a) return;
    g.strokeStyle = style.theme("accent");
    g.lineWidth = 3;
    g.setLineDash([6, 4]);
    g.strokeRect(
      Math.min(a.x, b.x) * size + 1.5, Math.min(a.y, b.y) * size + 1.5,
      (Math.abs(a.x - b.x) + 1) * size - 3, (Math.abs(a.y - b.y) + 1) * size - 3,
    );
    g.setLineDash([]);
  }
}
