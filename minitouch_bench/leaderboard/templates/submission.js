"use strict";
(() => {
  const data = JSON.parse(document.getElementById("episode-data").textContent);
  const section = document.querySelector(".episode-section");
  const [runs, tasks, ends] = ["run", "task", "ending"].map((id) => document.getElementById(`by-${id}`));
  const body = section.querySelector("tbody");
  const command = document.getElementById("replay-command");
  const count = section.querySelector(".count");
  const copy = section.querySelector(".copy");

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
  data.runs.forEach((run, place) => option(runs, place, run.title));
  option(tasks, "", "all");
  option(ends, "", "all");
  data.endings.forEach((ending, place) => option(ends, place, ending));

  const offerTasks = () => {
    const kept = tasks.value;
    tasks.replaceChildren();
    option(tasks, "", "all");
    for (const group of data.runs[runs.value].groups) option(tasks, group.key, group.key);
    if ([...tasks.options].some((one) => one.value === kept)) tasks.value = kept;
  };
  const pick = (row, key) => {
    for (const other of body.querySelectorAll("[aria-selected]")) other.removeAttribute("aria-selected");
    row.setAttribute("aria-selected", "true");
    command.textContent = data.runs[runs.value].command.replace("EPISODE", key);
  };
  const draw = () => {
    const rows = document.createDocumentFragment();
    let number = 0;
    for (const group of data.runs[runs.value].groups) {
      if (tasks.value && group.key !== tasks.value) continue;
      group.ending.forEach((ending, place) => {
        if (ends.value !== "" && ending !== Number(ends.value)) return;
        const key = `${group.key}/${group.index[place]}`;
        const row = document.createElement("tr");
        cell(row, key);
        const ended = cell(row, data.endings[ending], "words");
        const mark = document.createElement("i");
        mark.className = `swatch ${data.tones[ending]}`;
        ended.prepend(mark);
        cell(row, group.steps[place]);
        cell(row, group.touch[place]);
        cell(row, group.first[place] === null ? "—" : group.first[place].toFixed(2));
        cell(row, group.shapes ? group.shapes[place] : "", "words");
        const button = document.createElement("button");
        button.type = "button";
        button.className = "pick";
        button.textContent = "Replay";
        button.setAttribute("aria-label", `Show the command that replays ${key}`);
        button.addEventListener("click", () => pick(row, key));
        cell(row, "").append(button);
        rows.append(row);
        number += 1;
      });
    }
    body.replaceChildren(rows);
    count.textContent = `${number} ${number === 1 ? "episode" : "episodes"}`;
  };
  runs.addEventListener("change", () => { offerTasks(); draw(); });
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
  section.hidden = false;
  offerTasks();
  draw();
})();
