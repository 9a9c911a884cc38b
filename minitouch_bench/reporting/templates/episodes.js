"use strict";
(() => {
  const data = JSON.parse(document.getElementById("episode-data").textContent);
  const section = document.querySelector(".episode-section");
  const [runs, tasks, ends] = ["run", "task", "ending"].map((id) => document.getElementById(`by-${id}`));
  const body = section.querySelector("tbody");
  const command = document.getElementById("replay-command");
  const count = section.querySelector(".count");
  const copy = section.querySelector(".copy");
  const FAILURES = "failures";

  const option = (select, value, text) => {
    const made = document.createElement("option");
    made.value = value;
    made.textContent = text;
    select.append(made);
  };
  const cell = (row, text, className) => {
    const made = row.insertCell();
    made.textContent = text;
    if (className) made.className = className;
    return made;
  };
  const run = () => data.runs[runs.value];
  const offer = (select, choices) => {
    const kept = select.value;
    select.replaceChildren();
    option(select, "", "all");
    for (const [value, text] of choices) option(select, value, text);
    if ([...select.options].some((one) => one.value === kept)) select.value = kept;
  };
  // Of the run that is chosen: its tasks, and how its episodes ended.
  const offerChoices = () => {
    const groups = run().groups;
    const occurring = new Set(groups.flatMap((group) => group.ending));
    const endings = data.endings.map((ending, place) => [String(place), ending]).filter(([place]) => occurring.has(Number(place)));
    const failed = [...occurring].some((ending) => ending >= data.failures);
    offer(tasks, groups.map((group) => [group.key, group.key]));
    offer(ends, failed ? [[FAILURES, "all failures"], ...endings] : endings);
  };
  const isChosen = (ending) => ends.value === "" || (ends.value === FAILURES ? ending >= data.failures : ending === Number(ends.value));

  const quoted = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", `'"'"'`)}'`);
  // A page on a disk knows where its run is; one on a server does not.
  const path = () => {
    const { address } = run();
    if (!address || location.protocol !== "file:") return "RUN";
    return decodeURIComponent(new URL(`${address}/`, location.href).pathname).replace(/\/$/, "");
  };
  const pick = (row, key) => {
    for (const other of body.querySelectorAll("[aria-current]")) other.removeAttribute("aria-current");
    row.setAttribute("aria-current", "true");
    copy.disabled = false;
    const { evaluate } = run();
    command.textContent = evaluate
      ? `${evaluate} --episodes-from ${key} --replays 1`
      : `minitouch-bench replay ${quoted(path())} ${key}`;
  };
  const draw = () => {
    const found = [];
    for (const group of run().groups) {
      if (tasks.value && group.key !== tasks.value) continue;
      group.ending.forEach((ending, place) => { if (isChosen(ending)) found.push([group, ending, place]); });
    }
    found.sort((one, other) => other[1] - one[1]); // the worst ending first; otherwise in the run's order
    const rows = document.createDocumentFragment();
    for (const [group, ending, place] of found) {
      const key = `${group.key}/${group.index[place]}`;
      const row = document.createElement("tr");
      cell(row, key);
      const ended = cell(row, data.endings[ending], "words");
      const mark = document.createElement("i");
      mark.className = `swatch ${data.tones[ending]}`;
      ended.prepend(mark);
      cell(row, group.steps[place]);
      cell(row, group.share[place] === null ? "—" : group.share[place].toFixed(3));
      cell(row, group.ticks[place]);
      cell(row, group.first[place] === null ? "—" : group.first[place].toFixed(2));
      cell(row, group.shapes ? group.shapes[place] : "", "words");
      const viewer = run().viewers[key];
      const button = document.createElement(viewer ? "a" : "button");
      button.className = "pick";
      button.textContent = viewer ? "View" : "Replay";
      if (viewer) {
        button.href = viewer;
        button.setAttribute("aria-label", `View ${key}`);
      } else {
        button.type = "button";
        button.setAttribute("aria-label", `Show the command that replays ${key}`);
        button.addEventListener("click", () => pick(row, key));
      }
      cell(row, "").append(button);
      rows.append(row);
    }
    body.replaceChildren(rows);
    count.textContent = `${found.length} ${found.length === 1 ? "episode" : "episodes"}`;
  };
  runs.addEventListener("change", () => { offerChoices(); draw(); });
  tasks.addEventListener("change", draw);
  ends.addEventListener("change", draw);
  copy.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(command.textContent);
      copy.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(command);
      copy.textContent = "Selected";
    }
    setTimeout(() => { copy.textContent = "Copy"; }, 1500);
  });
  // The dots of a map: the nearest one to where a reader points.
  const nearest = (drawing, event) => {
    const toDrawing = drawing.getScreenCTM().inverse();
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(toDrawing);
    const found = { distance: 8 };
    for (const path of drawing.querySelectorAll("[data-episodes]")) {
      const indices = path.dataset.episodes.split(" ");
      [...path.getAttribute("d").matchAll(/M(\S+) (\S+?)h0/g)].forEach(([, left, top], place) => {
        const distance = Math.hypot(left - x, top - y);
        if (distance < found.distance) Object.assign(found, { distance, index: Number(indices[place]) });
      });
    }
    return found.index;
  };
  const goTo = (number, group, index) => {
    [runs.value, ends.value] = [number, ""];
    offerChoices();
    tasks.value = group;
    draw();
    const key = `${group}/${index}`;
    const row = [...body.rows].find((one) => one.cells[0].textContent === key);
    if (!row) return;
    pick(row, key);
    row.scrollIntoView({ block: "center" });
    row.querySelector(".pick").focus({ preventScroll: true });
  };
  for (const drawing of document.querySelectorAll("[data-source]")) {
    const [number, group] = drawing.dataset.source.split(" ");
    drawing.addEventListener("click", (event) => {
      const index = nearest(drawing, event);
      if (index !== undefined) goTo(number, group, index);
    });
  }
  data.runs.forEach((one, place) => option(runs, place, one.title));
  runs.parentElement.hidden = data.runs.length === 1;
  section.hidden = false;
  offerChoices();
  draw();
})();
