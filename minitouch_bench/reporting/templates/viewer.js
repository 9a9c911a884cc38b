"use strict";
(() => {
  const data = JSON.parse(document.getElementById("episode").textContent);
  // One episode, or the same one in two runs, whose control steps end at other times.
  const tracks = data.tracks;
  const single = tracks.length === 1;
  const [{ columns }] = tracks;
  const timesOf = (track) => track.columns.time_s;
  const times = [...new Set(tracks.flatMap(timesOf))].sort((one, other) => one - other);
  const steps = times.length - 1;
  const end = times[steps] || 1;
  const marks = tracks.flatMap((track) =>
    track.marks.map((mark) => ({ ...mark, text: single ? mark.text : `${track.name}: ${mark.text}` })));
  const LEFT = 44, RIGHT = 12, PAD = 7;

  // The panels: what is drawn below each other. A scale gives the place of a value, 0 to 1.
  const linear = (low, high) => (value) => (value - low) / (high - low);
  const root = (most) => (value) => (1 + Math.sign(value) * Math.sqrt(Math.abs(value) / most)) / 2;
  // A curve shows what the policy was given; where that is not the truth, there is a faint curve too.
  const curve = (column, name, tone) => {
    const given = columns[`given_${column}`];
    return { values: given || columns[column], truth: given && columns[column], times, name, tone };
  };
  const force = (finger) => ({
    title: `Force on the ${finger} finger, N`,
    scale: root(data.limit * 1.1),
    ticks: data.limit > 50 ? [-200, -50, 0, 50, 200] : [-50, -10, 0, 10, 50],
    limits: [-data.limit, data.limit], limit: `limit ${data.limit} N`, height: 112,
    digits: 1,
    curves: [["x", "x across"], ["y", "y squeeze"], ["z", "z along"]].map(([axis, name], index) =>
      curve(`${finger}_force_${axis}_N`, name, `series-${index}`)),
  });
  const asked = (title, names) => ({
    title, scale: linear(-1.05, 1.05), ticks: [-1, 0, 1], digits: 2, stepped: true,
    curves: names.filter((name) => columns[`action_${name}`]).map((name, index) =>
      curve(`action_${name}`, name, `series-${index}`)),
  });
  const each = (values) => tracks.map((track, index) => (
    { values: values(track), times: timesOf(track), name: single ? "" : track.name, tone: `series-${index}` }));
  const { goal, title, unit } = tracks[0].progress;
  const all = [...tracks.flatMap((track) => track.progress.values), ...(goal === null ? [] : [goal, 0])];
  const low = Math.min(...all), high = Math.max(...all, low + 1);
  const round = (value) => Math.round(value * 10) / 10;
  const progress = {
    title: `${title}, ${unit}`, scale: linear(low - (high - low) * 0.06, high + (high - low) * 0.06),
    ticks: [low, high].map(round), limits: goal === null ? [] : [goal], limit: `goal ${goal} ${unit}`, digits: 1,
    curves: each((track) => track.progress.values),
  };
  const larger = ({ columns: felt }) => timesOf({ columns: felt }).map((_, step) => Math.max(...["left", "right"].map((finger) =>
    Math.hypot(...["x", "y", "z"].map((axis) => felt[`${finger}_force_${axis}_N`][step])))));
  const most = data.limit * Math.sqrt(3);
  const panels = single ? [
    force("left"),
    force("right"),
    { title: "Contact, ticks of the step", scale: linear(0, 105), ticks: [0, 50, 100], digits: 0, bars: true,
      curves: [curve("contact_ticks", "in contact", "touched")] },
    { title: "Opening of the fingers, mm", scale: linear(-2, 42), ticks: [0, 20, 40], digits: 1,
      curves: [curve("left_opening_mm", "left", "series-3"), curve("right_opening_mm", "right", "series-4")] },
    asked("Action: move the end effector", ["dx", "dy", "dz"]),
    asked("Action: fingers (1 opens)", ["fingers", "yaw"]),
    progress,
  ] : [
    { title: "Force of the finger that feels more, N", scale: (value) => Math.sqrt(value / most), height: 180, digits: 1,
      ticks: data.limit > 50 ? [0, 10, 50, 200] : [0, 2, 10, 50], limits: [data.limit], limit: `limit ${data.limit} N of each component`,
      curves: each(larger) },
    { title: "Contact, ticks of the step", scale: linear(0, 105), ticks: [0, 50, 100], digits: 0, stepped: true,
      curves: each((track) => track.columns.contact_ticks) },
    progress,
  ];

  // Drawing
  const make = (parent, name, attributes = {}, text = "") => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.textContent = text;
    parent.append(made);
    return made;
  };
  const element = (parent, name, className = "", text = "") => {
    const made = document.createElement(name);
    made.className = className;
    made.textContent = text;
    parent.append(made);
    return made;
  };
  const place = document.querySelector(".panels");
  const cursor = document.querySelector(".cursor");
  const labels = document.querySelector(".labels");
  const labelHeight = 6 + 17 * Math.max(marks.length, 2);
  labels.style.height = `${labelHeight}px`;
  cursor.style.top = `${labelHeight - 6}px`;
  let width = 0;
  const x = (time) => LEFT + (time / end) * (width - LEFT - RIGHT);
  const readouts = [];
  for (const panel of panels) {
    panel.root = element(place, "div", "plot");
    const head = element(panel.root, "h2", "", panel.title);
    for (const one of panel.curves) {
      const item = element(head, "span", one.tone);
      if (one.name) element(item, "i");
      item.append(one.name);
      readouts.push({ out: element(item, "b"), digits: panel.digits, ...one });
    }
    if (panel.limits?.length) {
      const item = element(head, "span", "dashed");
      element(item, "i");
      item.append(panel.limit);
    }
    if (panel.curves.some((one) => one.truth)) element(head, "span", "", "bold: what the policy was given; faint: the truth");
  }
  const path = (panel, values, times, y) => {
    let line = "";
    values.forEach((value, step) => {
      if (value === null) return;
      if (panel.stepped) line += `${line ? "L" : "M"}${x(times[step - 1])} ${y(value)}H${x(times[step])}`;
      else line += `${line ? "L" : "M"}${x(times[step])} ${y(value)}`;
    });
    return line;
  };
  const drawPanel = (panel, isLast) => {
    panel.root.querySelector("svg")?.remove();
    const height = panel.height || 84;
    const bottom = height + (isLast ? 18 : 0);
    const svg = make(panel.root, "svg", { viewBox: `0 0 ${width} ${bottom}`, height: bottom, role: "img", "aria-label": panel.title });
    const y = (value) => height - PAD - Math.min(Math.max(panel.scale(value), 0), 1) * (height - 2 * PAD);
    make(svg, "rect", { class: "frame", x: LEFT, y: 0.5, width: width - LEFT - RIGHT, height: height - 1, rx: 4 });
    for (const tick of panel.ticks) {
      make(svg, "line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: y(tick), y2: y(tick) });
      make(svg, "text", { x: LEFT - 6, y: y(tick) + 4, "text-anchor": "end" }, String(tick).replace("-", "−"));
    }
    for (const [step, ticks] of single ? columns.contact_ticks.entries() : []) {
      const box = { x: x(times[step - 1]), width: Math.max(x(times[step]) - x(times[step - 1]), 0.5) };
      if (ticks && !panel.bars) make(svg, "rect", { class: "shade", y: 1, height: height - 2, ...box });
      if (ticks && panel.bars) make(svg, "rect", { class: "bar", y: y(ticks), height: y(0) - y(ticks), ...box });
    }
    for (const limit of panel.limits || []) {
      make(svg, "line", { class: "bound", x1: LEFT, x2: width - RIGHT, y1: y(limit), y2: y(limit) });
    }
    for (const mark of marks) {
      make(svg, "line", { class: `event ${mark.tone}`, x1: x(mark.time), x2: x(mark.time), y1: 0, y2: height });
    }
    for (const one of panel.bars ? [] : panel.curves) {
      if (one.truth) make(svg, "path", { class: `curve faint ${one.tone}`, d: path(panel, one.truth, one.times, y) });
      make(svg, "path", { class: `curve ${one.truth ? "bold " : ""}${one.tone}`, d: path(panel, one.values, one.times, y) });
    }
    if (isLast) {
      const unit = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20].find((one) => (end / one) * 52 < width) || 50;
      for (let time = 0; time <= end; time += unit) {
        make(svg, "text", { x: x(time), y: bottom - 3, "text-anchor": "middle" }, `${Number(time.toFixed(1))}${time ? "" : " s"}`);
      }
    }
  };
  const draw = () => {
    width = place.clientWidth;
    panels.forEach((panel, index) => drawPanel(panel, index === panels.length - 1));
    labels.replaceChildren();
    marks.forEach((mark, index) => {
      const label = element(labels, "span", mark.tone, mark.text);
      const room = width - label.offsetWidth;
      label.style.left = `${Math.min(Math.max(x(mark.time) - label.offsetWidth / 2, 0), room)}px`;
      label.style.top = `${index * 17}px`;
    });
    show();
  };

  // The moment that is shown
  const sprites = tracks.flatMap((track, number) => (single ? ["scenes", "images"] : ["scenes"]).map((name) => {
    const canvas = document.getElementById(`${name}${number || ""}`);
    const source = track[name];
    [canvas.width, canvas.height] = [source.width, source.height];
    const picture = new Image();
    picture.onload = () => show();
    picture.src = source.uri;
    return { source, picture, times: timesOf(track), context: canvas.getContext("2d") };
  }));
  const [seek, play, speed, now] = ["seek", "play", "speed", "now"].map((id) => document.getElementById(id));
  seek.max = steps;
  let moment = 0, started = null;
  const stepAt = (time, ends = times) => {
    let step = 0;
    while (step < ends.length - 1 && ends[step + 1] <= time + 1e-9) step += 1;
    return step;
  };
  const show = () => {
    const step = stepAt(moment);
    for (const { source, picture, times: ends, context } of sprites) {
      const index = Math.min(stepAt(moment, ends), source.count - 1);
      const [left, top] = [(index % source.columns) * source.width, Math.floor(index / source.columns) * source.height];
      if (picture.complete && index >= 0) {
        context.drawImage(picture, left, top, source.width, source.height, 0, 0, source.width, source.height);
      }
    }
    for (const { out, values, digits, times: ends } of readouts) {
      const value = values[stepAt(moment, ends)];
      out.textContent = value === null ? "" : value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1").replace("-", "−");
    }
    cursor.style.transform = `translateX(${x(moment)}px)`;
    const where = tracks.map((track) => {
      const reached = stepAt(moment, timesOf(track));
      const text = reached ? `step ${reached} of ${timesOf(track).length - 1}` : "reset";
      return single ? text : `${track.name}: ${text}`;
    });
    now.textContent = [...where, `${times[step].toFixed(2)} s`].join(", ");
    seek.setAttribute("aria-valuetext", now.textContent);
    if (Number(seek.value) !== step) seek.value = step;
  };
  const stop = () => {
    started = null;
    play.textContent = "Play";
  };
  const goTo = (step) => {
    stop();
    moment = times[Math.min(Math.max(step, 0), steps)];
    show();
  };
  const advance = (clock) => {
    if (started === null) return;
    moment = Math.min(started.moment + ((clock - started.clock) / 1000) * Number(speed.value), times[steps]);
    show();
    if (moment >= times[steps]) stop();
    else requestAnimationFrame(advance);
  };
  const toggle = () => {
    if (started !== null) return goTo(stepAt(moment));
    if (moment >= times[steps]) moment = 0;
    started = { moment, clock: performance.now() };
    play.textContent = "Pause";
    requestAnimationFrame(advance);
  };
  play.addEventListener("click", toggle);
  speed.addEventListener("change", () => { if (started) started = { moment, clock: performance.now() }; });
  seek.addEventListener("input", () => goTo(Number(seek.value)));
  const point = (event) => {
    const time = ((event.clientX - place.getBoundingClientRect().left - LEFT) / (width - LEFT - RIGHT)) * end;
    const step = stepAt(time);
    goTo(step < steps && times[step + 1] - time < time - times[step] ? step + 1 : step);
  };
  // A finger may be about to scroll: it points by a tap.
  const drags = (event) => event.buttons && event.pointerType !== "touch";
  place.addEventListener("pointerdown", (event) => { if (drags(event)) { place.setPointerCapture(event.pointerId); point(event); } });
  place.addEventListener("pointermove", (event) => { if (drags(event)) point(event); });
  place.addEventListener("click", point);
  document.addEventListener("keydown", (event) => {
    if (event.target === speed || event.ctrlKey || event.metaKey || event.altKey) return;
    const by = event.shiftKey ? 10 : 1;
    const to = { ArrowLeft: stepAt(moment) - by, ArrowRight: stepAt(moment) + by, Home: 0, End: steps }[event.key];
    if (to !== undefined) goTo(to);
    else if (event.key === " " && !event.target.closest("button")) toggle();
    else return;
    event.preventDefault();
  });

  document.querySelector(".viewer").hidden = false;
  new ResizeObserver(() => { if (place.clientWidth > LEFT + RIGHT && place.clientWidth !== width) draw(); }).observe(place);
  draw();
})();
