// The page: state, controls, and what it asks the server.

const byId = (id) => document.getElementById(id);
const setup = JSON.parse(byId("setup").textContent);

const ask = async (action, content) => {
  let reply;
  try {
    reply = await fetch(action, {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content),
    });
  } catch {
    return { error: "The editor's server does not answer: was it stopped?" };
  }
  return reply.ok ? reply.json() : { error: await reply.text() };
};

class Editor {
  constructor() {
    this.history = new History();
    this.drawing = Drawing.from(setup.start);
    this.stored = this.text();
    this.brush = 3;
    this.active = 0;
    this.other = null; // the drawing of the other kind, to come back to
    this.running = false;
    this.checks = 0;
    this.board = new Board(byId("board"), {
      onStroke: (cells, erase, begins) => this.stroke(cells, erase, begins), onEnd: () => this.changed(),
    });
    byId("name").value = setup.start.name ?? "my_robot";
    this.chooseTheme();
    this.fillIn();
    this.listen();
    this.changed();
    this.listFiles();
  }

  // ------------------------------------------------------------------------- commands

  stroke(cells, erase, begins) {
    if (begins) this.history.keep(this.drawing.copy());
    for (const { x, y } of cells) this.drawing.set(x, y, erase ? 0 : this.brush, this.active);
    this.show();
  }

  replace(drawing) {
    this.history.keep(this.drawing);
    this.drawing = drawing;
    this.changed();
  }

  text() { return JSON.stringify(this.drawing.toDocument()); }

  undo() { this.drawing = this.history.back(this.drawing); this.changed(); }
  redo() { this.drawing = this.history.forth(this.drawing); this.changed(); }

  chooseKind(kind) {
    if (kind === this.drawing.kind) return;
    const next = this.other ?? (kind === "world"
      ? Drawing.worldWith(this.drawing)
      : Drawing.from({ kind, names: ["robot"], types: setup.examples.walker, owners: setup.examples.walker.map((row) => row.map(() => 0)) }));
    this.other = this.drawing;
    this.history = new History();
    this.drawing = next;
    this.active = this.drawing.names.length - 1;
    this.changed();
  }

  chooseBrush(type) {
    if (type === 5 && this.drawing.kind === "body") return;
    this.brush = type;
    this.show();
  }

  resize(columns, rows) {
    const [most, high] = setup.limits[this.drawing.kind], clip = (value, top) => Math.min(top, Math.max(1, Math.round(value) || 1));
    const width = clip(columns, most), height = clip(rows, high);
    if (width !== this.drawing.width || height !== this.drawing.height) this.replace(this.drawing.resized(width, height));
    else this.show();
  }

  clear() { this.replace(new Drawing(this.drawing.kind, this.drawing.names, this.drawing.width, this.drawing.height)); }

  begin(rows) { this.replace(Drawing.from({ kind: "body", names: ["robot"], types: rows, owners: rows.map((row) => row.map(() => 0)) })); }

  async random() {
    const { width, height } = this.drawing;
    const found = await ask("sample", { rows: Math.min(10, height), columns: Math.min(10, width) });
    if (found.error) this.say("outcome", found.error, true);
    else if (this.drawing.kind === found.kind) this.replace(Drawing.from(found)); // it may be the world's turn by now
  }

  addObject() {
    const copy = this.drawing.copy();
    let number = copy.names.length;
    while (copy.names.includes(`object_${number}`)) number++;
    copy.names.push(`object_${number}`);
    this.active = copy.names.length - 1;
    this.replace(copy);
  }

  rename(number, name) {
    const copy = this.drawing.copy();
    copy.names[number] = name;
    this.replace(copy);
  }

  remove(number) {
    this.active = 0;
    this.replace(this.drawing.without(number));
  }

  // -------------------------------------------------------------------- with the server

  async check() {
    const number = ++this.checks, answer = await ask("check", { document: this.drawing.toDocument() });
    if (number !== this.checks) return; // something newer is on its way
    this.valid = !answer.error;
    this.say("verdict", answer.error ?? answer.message, !this.valid);
    this.showButtons();
  }

  async save(overwrite = false) {
    const name = byId("name").value.trim(), text = this.text();
    const answer = await ask("save", { document: this.drawing.toDocument(), name, overwrite });
    if (answer.exists) {
      byId("ask").querySelector("p").textContent = `${answer.exists} exists. Replace it?`;
      byId("ask").returnValue = "no";
      byId("ask").showModal();
      return;
    }
    if (!answer.error) this.stored = text;
    this.say("outcome", answer.error ?? answer.message, Boolean(answer.error));
    this.listFiles();
  }

  async listFiles() {
    const { files = [] } = await ask("files", {});
    byId("open").replaceChildren(new Option("choose …", ""), ...files.map((file) => new Option(file, file)));
  }

  async open(name) {
    const found = await ask("open", { name });
    if (found.error) { this.say("outcome", found.error, true); return; }
    byId("name").value = name.replace(/\.json$/, "");
    if (found.kind === this.drawing.kind) this.history.keep(this.drawing);
    else {
      const before = this.other;
      this.other = this.drawing;
      this.history = new History();
      if (before) this.history.keep(before);
    }
    this.active = 0;
    this.drawing = Drawing.from(found);
    this.stored = this.text();
    this.changed();
    this.say("outcome", `Opened ${name}.`, false);
  }

  async run() {
    if (this.running || !this.valid) return;
    this.running = true;
    this.showButtons();
    this.say("outcome", "Simulating …", false);
    const answer = await ask("rollout", {
      document: this.drawing.toDocument(), agent: byId("agent").value, task: byId("task").value,
      seconds: Number(byId("seconds").value), seed: Number(byId("seed").value),
    });
    this.running = false;
    this.showButtons();
    this.say("outcome", answer.error ?? answer.message, Boolean(answer.error));
    const theme = document.documentElement.dataset.theme;
    if (!answer.error) byId("player").src = `rollout/${answer.rollout}#theme=${theme}`;
  }

  // ------------------------------------------------------------------------------- page

  chooseTheme(name) {
    const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    document.documentElement.dataset.theme = name ?? system;
    const css = getComputedStyle(document.documentElement), colours = {};
    for (const [cell, rgb] of Object.entries(setup.colours)) colours[cell] = `rgb(${rgb})`;
    this.style = { colours, theme: (key) => css.getPropertyValue("--" + key).trim() };
    if (this.board.drawing) this.show();
  }

  fillIn() {
    byId("about").textContent = `folder ${setup.folder}`;
    for (const [type, name] of Object.entries(setup.names)) {
      const button = document.createElement("button"), swatch = document.createElement("i"), key = document.createElement("kbd");
      Object.assign(button, { type: "button", id: `material-${type}` });
      button.setAttribute("role", "radio");
      swatch.style.background = setup.colours[type] ? `rgb(${setup.colours[type]})` : "none";
      key.textContent = type;
      button.append(swatch, name, key);
      button.addEventListener("click", () => this.chooseBrush(Number(type)));
      byId("materials").append(button);
    }
    byId("example").append(new Option("an example …", ""), ...Object.keys(setup.examples).map((name) => new Option(name, name)));
    setup.tasks.forEach((task) => byId("task").add(new Option(task, task)));
    setup.agents.forEach((agent) => byId("agent").add(new Option(agent, agent)));
    byId("task").value = "Walker-v0";
    byId("seconds").max = setup.limits.seconds;
  }

  listen() {
    const on = (id, event, action) => byId(id).addEventListener(event, action);
    on("body", "click", () => this.chooseKind("body"));
    on("world", "click", () => this.chooseKind("world"));
    on("undo", "click", () => this.undo());
    on("redo", "click", () => this.redo());
    on("clear", "click", () => this.clear());
    on("add", "click", () => this.addObject());
    on("random", "click", () => this.random());
    on("save", "click", () => this.save());
    on("run", "click", () => this.run());
    on("theme", "click", () => this.toggleTheme());
    for (const id of ["columns", "rows"]) on(id, "change", () => this.resize(byId("columns").value, byId("rows").value));
    on("example", "change", (event) => { if (event.target.value) this.begin(setup.examples[event.target.value]); event.target.value = ""; });
    on("open", "change", (event) => { if (event.target.value) this.open(event.target.value); event.target.value = ""; });
    on("ask", "close", () => { if (byId("ask").returnValue === "yes") this.save(true); });
    addEventListener("resize", () => this.show());
    addEventListener("keydown", (event) => this.onKey(event));
    addEventListener("beforeunload", (event) => { if (this.text() !== this.stored) event.preventDefault(); });
  }

  toggleTheme() { this.chooseTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"); }

  onKey(event) {
    const { key, ctrlKey, metaKey, shiftKey, altKey, target } = event, control = ctrlKey || metaKey;
    if (byId("ask").open || altKey || this.board.from) return; // in a stroke nothing else happens
    if (control && key.toLowerCase() === "s") { event.preventDefault(); this.save(); return; }
    if (target.matches("input, select")) return;
    const letter = key.toLowerCase();
    if (control && letter === "z") { event.preventDefault(); if (shiftKey) this.redo(); else this.undo(); }
    else if (control && letter === "y") { event.preventDefault(); this.redo(); }
    else if (control) return;
    else if (/^[0-5]$/.test(key)) this.chooseBrush(Number(key));
    else if (letter === "r") this.run();
    else if (letter === "t") this.toggleTheme();
    else if (target === byId("board") && this.board.key(key)) event.preventDefault();
  }

  // After every finished change: show it, and ask whether it is valid.
  changed() {
    this.active = Math.min(this.active, this.drawing.names.length - 1);
    if (this.brush === 5 && this.drawing.kind === "body") this.brush = 3;
    this.show();
    this.showObjects();
    this.check();
  }

  show() {
    const { kind, width, height } = this.drawing;
    for (const name of ["body", "world"]) byId(name).setAttribute("aria-checked", name === kind);
    for (const type of Object.keys(setup.names)) {
      byId(`material-${type}`).setAttribute("aria-checked", Number(type) === this.brush);
    }
    byId("material-5").hidden = byId("starts").hidden = false;
    byId("material-5").disabled = kind === "body";
    byId("objects").hidden = kind === "body";
    byId("starts").hidden = kind === "world";
    byId("of-task").hidden = kind === "world";
    byId("columns").value = width;
    byId("rows").value = height;
    this.showButtons();
    this.board.show(this.drawing, this.active, this.style);
  }

  showButtons() {
    byId("undo").disabled = !this.history.past.length;
    byId("redo").disabled = !this.history.future.length;
    byId("run").disabled = this.running || !this.valid;
    byId("save").disabled = !this.valid;
  }

  showObjects() {
    byId("names").replaceChildren(...this.drawing.names.map((name, number) => {
      const row = document.createElement("li"), choice = document.createElement("input");
      const text = document.createElement("input"), remove = document.createElement("button");
      Object.assign(choice, { type: "radio", name: "active", checked: number === this.active });
      choice.setAttribute("aria-label", `Paint ${name}`);
      choice.addEventListener("change", () => { this.active = number; this.show(); });
      Object.assign(text, { type: "text", value: name, maxLength: 64, spellcheck: false });
      text.setAttribute("aria-label", "Name of the object");
      text.addEventListener("change", () => this.rename(number, text.value.trim()));
      Object.assign(remove, { type: "button", textContent: "×", title: `Remove ${name}`, disabled: this.drawing.names.length < 2 });
      remove.addEventListener("click", () => this.remove(number));
      row.append(choice, text, remove);
      return row;
    }));
  }

  say(id, text, bad) {
    byId(id).textContent = text;
    byId(id).classList.toggle("bad", bad);
    byId(id).classList.toggle("good", !bad);
  }
}

globalThis.editor = new Editor();
