"use strict";
const all = (selector, root = document) => [...root.querySelectorAll(selector)];

// Theme: the first click leaves what the system prefers.
const dark = () => (document.documentElement.dataset.theme || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
const theme = document.getElementById("theme");
const name = () => { theme.textContent = dark() ? "light theme" : "dark theme"; };
theme.addEventListener("click", () => { document.documentElement.dataset.theme = dark() ? "light" : "dark"; name(); });
name();

// Tables: a click on a heading sorts, a second one turns the order; what is missing stays last.
for (const table of all("table.sortable")) {
  const heads = all("thead th", table), body = table.tBodies[0];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const down = column > 0 ? head.getAttribute("aria-sort") !== "descending" : head.getAttribute("aria-sort") === "ascending";
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const key = (row) => row.cells[column].dataset.value;
    const order = (a, b) => column > 0 ? Number(a) - Number(b) : a.localeCompare(b);
    const rows = [...body.rows].sort((a, b) => (key(a) === "") - (key(b) === "") || (down ? -1 : 1) * order(key(a), key(b)));
    body.append(...rows);
  }));
}

// Tables that go on beyond the right edge say so.
for (const box of all(".scroll")) {
  const tell = () => box.parentElement.classList.toggle("more", box.scrollWidth - box.clientWidth - box.scrollLeft > 8);
  box.addEventListener("scroll", tell, { passive: true });
  addEventListener("resize", tell);
  addEventListener("load", tell);
  box.closest("details")?.addEventListener("toggle", tell);
  tell();
}

// Legends: one click hides an agent everywhere.
for (const key of all("[data-toggle]")) {
  key.addEventListener("click", () => {
    const slot = key.dataset.toggle, shown = key.getAttribute("aria-pressed") === "false";
    all(`[data-toggle="${slot}"]`).forEach((other) => other.setAttribute("aria-pressed", String(shown)));
    all(`[data-agent="${slot}"]`).forEach((part) => part.classList.toggle("gone", !shown));
  });
}

// Charts: the nearest point of every line.
const tip = document.getElementById("tip");
for (const chart of all("svg[data-hover]")) {
  const series = JSON.parse(chart.dataset.hover), cursor = chart.querySelector(".cursor");
  const leave = () => { tip.hidden = true; cursor.setAttribute("visibility", "hidden"); };
  chart.addEventListener("pointermove", (event) => {
    const box = chart.getBoundingClientRect(), x = (event.clientX - box.left) / box.width * chart.viewBox.baseVal.width;
    const hidden = new Set(all(".gone[data-agent]", chart).map((part) => part.dataset.agent));
    const near = series.filter((s) => s.p.length && !hidden.has(String(s.c)))
      .map((s) => ({ s, p: s.p.reduce((a, b) => Math.abs(b[0] - x) < Math.abs(a[0] - x) ? b : a) }));
    if (!near.length) return leave();
    const best = near.reduce((a, b) => Math.abs(b.p[0] - x) < Math.abs(a.p[0] - x) ? b : a).p;
    tip.replaceChildren(document.createTextNode(`${best[2]} ${chart.dataset.across}`));
    for (const { s, p } of near.filter(({ p }) => Math.abs(p[0] - best[0]) < 24).sort((a, b) => a.p[1] - b.p[1])) {
      const line = document.createElement("div"), value = document.createElement("b");
      value.textContent = p[3];
      line.append(s.n, value);
      tip.append(line);
    }
    cursor.setAttribute("x1", best[0]); cursor.setAttribute("x2", best[0]); cursor.setAttribute("visibility", "visible");
    tip.hidden = false;
    tip.style.left = `${Math.max(4, Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8))}px`;
    tip.style.top = `${Math.max(4, event.clientY - tip.offsetHeight - 12)}px`;
  });
  chart.addEventListener("pointerleave", leave);
}

// Print shows everything.
addEventListener("beforeprint", () => all("details").forEach((part) => { part.open = true; }));
