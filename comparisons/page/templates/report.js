"use strict";
(() => {
  const collator = new Intl.Collator("en", { numeric: true, sensitivity: "base" });
  const empty = new Set(["", "—", "–", "-", "?", "n/a", "nan", "none", "not known"]);
  const prefixes = { p: 1e-12, n: 1e-9, u: 1e-6, "\u00b5": 1e-6, "\u03bc": 1e-6, m: 1e-3, k: 1e3, M: 1e6, G: 1e9 };
  const bases = /^(?:Hz|Pa|rad|bar|s|V|A|N|K|W|J|T|C|F|H|Ω|l|L|g|m)(?![A-Za-z])/;
  const superscripts = "⁰¹²³⁴⁵⁶⁷⁸⁹";

  // Small print below a cell's value stands in an element of its own.
  const textOf = (cell) => (cell?.dataset.value ?? cell?.firstChild?.textContent ?? "").trim();

  function powerOfTen(digits) {
    const plain = [...digits].map((c) => (c === "⁻" ? "-" : superscripts.indexOf(c))).join("");
    return 10 ** Number(plain);
  }

  // "−0.12 ± 0.03 ms": a value and its unit; null for what does not begin with a number.
  function quantity(text) {
    const plain = text
      .replace(/\u2212/g, "-")
      .replace(/(\d)[\u00a0\u2009\u202f,](?=\d{3}(?!\d))/g, "$1")
      .replace(/^[~≈<>≤≥=(\s]+/, "");
    const endless = /^([+-]?)(?:∞|inf(?![a-z]))/i.exec(plain);
    if (endless) return { value: endless[1] === "-" ? -Infinity : Infinity, unit: "" };
    const number = /^[+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?/i.exec(plain);
    if (!number) return null;
    let rest = plain.slice(number[0].length);
    if (!/^(?:$|[\s·×%°±…);,])/.test(rest)) return null;
    rest = rest.replace(/^\s*±\s*(?:[\d.]+(?:e[+-]?\d+)?|\?)\)?/i, "");
    rest = rest.replace(/^\s*(?:…|to)\s*[+-]?[\d.]+(?:e[+-]?\d+)?/i, "");
    let value = Number(number[0]);
    const power = /^\s*(?:e([+-]?\d+)|[·×]\s*10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))/.exec(rest);
    if (power) {
      value *= power[1] ? 10 ** Number(power[1]) : powerOfTen(power[2]);
      rest = rest.slice(power[0].length);
    }
    return { value, unit: rest.trim() };
  }

  function parted(unit) {
    if (!bases.test(unit) && unit[0] in prefixes && bases.test(unit.slice(1))) {
      return { base: unit.slice(1), scale: prefixes[unit[0]] };
    }
    return { base: unit, scale: 1 };
  }

  // Keys of a column: numbers where its cells are numbers, else text; null where a cell is empty.
  function keysOf(rows, column, numeric) {
    const texts = rows.map((row) => textOf(row.cells[column]));
    const read = texts.map((text) => (empty.has(text.toLowerCase()) ? null : quantity(text)));
    const known = read.filter(Boolean);
    const filled = texts.filter((text) => !empty.has(text.toLowerCase())).length;
    if (!known.length || (!numeric && known.length < filled)) {
      return { keys: texts.map((text) => (empty.has(text.toLowerCase()) ? null : text)), compare: collator.compare };
    }
    const units = known.map((one) => parted(one.unit));
    const alike = units.every((unit) => unit.base === units[0].base);
    const keys = read.map((one) => one && one.value * (alike ? parted(one.unit).scale : 1));
    return { keys, compare: (a, b) => (a === b ? 0 : a < b ? -1 : 1) };
  }

  function sort(table, column, direction) {
    const body = table.tBodies[0];
    const rows = table.unsorted;
    const head = table.tHead.rows[0].cells;
    for (const cell of head) cell.removeAttribute("aria-sort");
    if (direction === "none") {
      body.append(...rows);
      return;
    }
    head[column].setAttribute("aria-sort", direction);
    const { keys, compare } = keysOf(rows, column, head[column].classList.contains("numeric"));
    const sign = direction === "ascending" ? 1 : -1;
    const order = rows.map((_, place) => place);
    order.sort((a, b) => {
      if (keys[a] === null || keys[b] === null) return (keys[a] === null) - (keys[b] === null);
      return sign * compare(keys[a], keys[b]);
    });
    body.append(...order.map((place) => rows[place]));
  }

  const following = { none: "ascending", ascending: "descending", descending: "none" };

  function makeSortable(table) {
    table.unsorted = [...table.tBodies[0].rows];
    [...table.tHead.rows[0].cells].forEach((cell, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "sort";
      button.append(...cell.childNodes);
      cell.append(button);
      cell.addEventListener("click", () => {
        sort(table, column, following[cell.getAttribute("aria-sort") ?? "none"]);
      });
    });
  }

  function enlarger() {
    const dialog = document.createElement("dialog");
    dialog.className = "enlarged";
    const close = document.createElement("button");
    close.type = "button";
    close.textContent = "Close";
    const picture = document.createElement("img");
    dialog.append(close, picture);
    dialog.addEventListener("click", () => dialog.close());
    document.body.append(dialog);
    return (title, image, opener) => {
      dialog.setAttribute("aria-label", title);
      picture.src = image.src;
      picture.alt = image.alt;
      // Closing gives the focus back to what had it.
      opener.focus();
      dialog.showModal();
      dialog.scrollTo(0, 0);
    };
  }

  function makeLarger(figure, enlarge) {
    const image = figure.querySelector("img");
    const heading = figure.querySelector("h4");
    const button = document.createElement("button");
    button.type = "button";
    button.className = "enlarge";
    button.textContent = "Enlarge";
    button.setAttribute("aria-label", `Enlarge: ${heading.textContent}`);
    const open = () => enlarge(heading.textContent, image, button);
    button.addEventListener("click", open);
    image.addEventListener("click", open);
    image.classList.add("enlargeable");
    heading.after(button);
  }

  for (const table of document.querySelectorAll("table.sortable")) makeSortable(table);
  const figures = document.querySelectorAll("figure");
  if (figures.length) {
    const enlarge = enlarger();
    for (const figure of figures) makeLarger(figure, enlarge);
  }
})();
