"use strict";
(() => {
  const text = (cell) => (cell.firstChild?.textContent ?? "").trim();

  // "−0.12 ± 0.03 ms" is sorted as −0.12, what others are compared to as 0; null for no number.
  function number(words) {
    if (words === "least" || words === "reference") return 0;
    const plain = words.replace(/\u2212/g, "-").replace(/^[~≈<>≤≥(\s]+/, "");
    const scaled = /^([-+]?[\d.]+)(?: ± [\d.]+\))?e([-+]?\d+)/.exec(plain);
    if (scaled) return Number(scaled[1]) * 10 ** Number(scaled[2]);
    const value = parseFloat(plain);
    return Number.isNaN(value) ? null : value;
  }

  function sort(table, column, descending) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head) => head.removeAttribute("aria-sort"));
    heads[column].setAttribute("aria-sort", descending ? "descending" : "ascending");
    const numeric = heads[column].classList.contains("numeric");
    const rows = [...table.tBodies[0].rows].map((row) => {
      const words = text(row.cells[column]);
      return { row, key: numeric ? number(words) : words || null };
    });
    const sign = descending ? -1 : 1;
    rows.sort((a, b) => {
      // What is not known comes last either way.
      if (a.key === null || b.key === null) return (a.key === null) - (b.key === null);
      return sign * (numeric ? a.key - b.key : a.key.localeCompare(b.key, "en", { numeric: true }));
    });
    table.tBodies[0].append(...rows.map(({ row }) => row));
  }

  for (const table of document.querySelectorAll("table.sortable")) {
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "sort";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        sort(table, column, head.getAttribute("aria-sort") === "ascending");
      });
    });
  }

  // Paper does not unfold.
  addEventListener("beforeprint", () => {
    for (const part of document.querySelectorAll("details")) part.open = true;
  });

  // A picture is shown in its own size, and small again, at a click.
  for (const image of document.querySelectorAll(".drawn img")) {
    image.addEventListener("click", () => image.classList.toggle("large"));
  }
})();
