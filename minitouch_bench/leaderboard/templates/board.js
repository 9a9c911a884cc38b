"use strict";
(() => {
  const views = [...document.querySelectorAll(".view")];
  const tabs = [...document.querySelectorAll(".tabs a")];
  const controls = document.querySelector(".controls");
  const count = document.querySelector(".count");
  const search = document.querySelector(".search");

  // Tabs: without this script every view stands below the other.
  const show = (key, focus) => {
    const chosen = views.some((view) => view.dataset.view === key) ? key : views[0].dataset.view;
    for (const view of views) view.hidden = view.dataset.view !== chosen;
    for (const tab of tabs) {
      const selected = tab.dataset.view === chosen;
      tab.setAttribute("aria-selected", String(selected));
      tab.tabIndex = selected ? 0 : -1;
      if (selected && focus) tab.focus();
    }
    tell();
  };
  const choose = (tab, focus) => {
    show(tab.dataset.view, focus);
    remember();
  };
  for (const [place, tab] of tabs.entries()) {
    tab.addEventListener("click", (event) => { event.preventDefault(); choose(tab, true); });
    tab.addEventListener("keydown", (event) => {
      const moves = { ArrowRight: place + 1, ArrowLeft: place - 1, Home: 0, End: tabs.length - 1 };
      if (!(event.key in moves)) return;
      event.preventDefault();
      choose(tabs[(moves[event.key] + tabs.length) % tabs.length], true);
    });
  }
  addEventListener("hashchange", () => {
    const [key] = location.hash.slice(1).split("?");
    if (!key || views.some((view) => view.dataset.view === key)) recall(); // not for #main or #submit
  });

  // Sorting: the ranked rows of one table; rows without a figure come last either way.
  const keyOf = (row, column) => {
    const text = row.cells[column]?.dataset.key;
    return text === undefined || text === "" ? null : text;
  };
  const compare = (one, other, numeric) => {
    if (one === null || other === null) return (one === null) - (other === null);
    return numeric ? one - other : one.localeCompare(other);
  };
  const sort = (table, head) => {
    const column = head.cellIndex;
    const body = table.querySelector("tbody.ranked");
    const numeric = head.dataset.type !== "text";
    const first = head.dataset.first;
    const other = first === "ascending" ? "descending" : "ascending";
    const order = head.getAttribute("aria-sort") === first ? other : first;
    const sign = order === "ascending" ? 1 : -1;
    const rows = [...body.rows].map((row) => ({ row, key: keyOf(row, column) }));
    rows.sort((a, b) => (a.key === null || b.key === null)
      ? compare(a.key, b.key) : sign * compare(a.key, b.key, numeric));
    for (const cell of table.querySelectorAll("th[aria-sort]")) cell.setAttribute("aria-sort", "none");
    head.setAttribute("aria-sort", order);
    body.append(...rows.map(({ row }) => row));
  };
  for (const button of document.querySelectorAll(".sort")) {
    button.addEventListener("click", () => sort(button.closest("table"), button.closest("th")));
  }

  // Filters: every modality asked for; the words in name, method or learner.
  const asked = (name) => [...controls.querySelectorAll(`input[name="${name}"]:checked`)].map((box) => box.value);
  const filter = () => {
    const modalities = asked("modality");
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const wants = (row) => {
      const has = (row.dataset.modalities || "").split(" ");
      return modalities.every((one) => has.includes(one))
        && words.every((word) => row.dataset.name.includes(word));
    };
    for (const row of document.querySelectorAll("tr[data-name]")) row.hidden = !wants(row);
    tell();
  };
  // The address keeps the view and the filters, as in #overall?modality=touch&words=hac.
  const remember = () => {
    const view = views.find((one) => !one.hidden) || views[0];
    const kept = new URLSearchParams();
    for (const value of asked("modality")) kept.append("modality", value);
    if (search.value) kept.set("words", search.value);
    const filters = kept.toString();
    history.replaceState(null, "", `#${view.dataset.view}${filters && `?${filters}`}`);
  };
  const recall = () => {
    const [key, filters] = location.hash.slice(1).split("?");
    const kept = new URLSearchParams(filters);
    for (const box of controls.querySelectorAll("input[type=checkbox]")) {
      box.checked = kept.getAll(box.name).includes(box.value);
    }
    search.value = kept.get("words") || "";
    filter();
    show(key);
  };
  const tell = () => {
    const view = views.find((one) => !one.hidden) || views[0];
    const rows = [...view.querySelectorAll("tbody.ranked tr[data-name]")];
    const wanted = rows.filter((row) => !row.hidden).length;
    count.textContent = wanted === rows.length
      ? `${wanted} ranked ${wanted === 1 ? "submission" : "submissions"}` : `${wanted} of ${rows.length} ranked submissions`;
  };
  controls.addEventListener("change", () => { filter(); remember(); });
  search.addEventListener("input", () => { filter(); remember(); });
  controls.hidden = false;
  recall();
})();
