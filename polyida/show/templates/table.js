"use strict";
// Tables sort by their columns: numbers by their value, what is missing last. Without this script they are as they were written.
for (const table of document.querySelectorAll("table")) {
  const heads = [...table.tHead.rows[0].cells];
  const known = (cell) => !cell.classList.contains("empty");
  const compare = (a, b) =>
    a.dataset.value === undefined || b.dataset.value === undefined
      ? a.textContent.localeCompare(b.textContent, "en", { numeric: true })
      : a.dataset.value - b.dataset.value;
  const sort = (column, sign) =>
    table.tBodies[0].append(
      ...[...table.tBodies[0].rows].sort((one, other) => {
        const [a, b] = [one.cells[column], other.cells[column]];
        return known(b) - known(a) || sign * compare(a, b);
      }),
    );
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    if (!button.textContent) button.setAttribute("aria-label", "name");
    head.append(button);
    button.addEventListener("click", () => {
      const rising = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", rising ? "ascending" : "descending");
      sort(column, rising ? 1 : -1);
    });
  });
}
