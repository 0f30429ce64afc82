const root = document.documentElement;
const dark = matchMedia("(prefers-color-scheme: dark)");
const paint = (isDark) => { root.dataset.theme = isDark ? "dark" : "light"; };
paint(dark.matches);
dark.addEventListener("change", (event) => paint(event.matches));
document.getElementById("theme").addEventListener("click", () => paint(root.dataset.theme !== "dark"));

const table = document.getElementById("all");
const body = table.tBodies[0];
const heads = [...table.tHead.rows[0].cells];
const value = (row, column) => {
  const text = row.cells[column].dataset.v;
  return text === "" ? -Infinity : Number(text);
};
heads.forEach((head, column) => {
  const button = head.querySelector("button");
  if (!button) return;
  button.addEventListener("click", () => {
    const falling = head.getAttribute("aria-sort") !== "descending";
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", falling ? "descending" : "ascending");
    const sign = falling ? -1 : 1;
    const rows = [...body.rows].sort((a, b) => sign * (value(a, column) - value(b, column)) || value(a, 0) - value(b, 0));
    body.append(...rows);
  });
});
