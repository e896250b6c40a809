"use strict";
(() => {
  // What is kept; the charts show a part of it.
  const SIGNALS_S = 600;
  const SPANS_S = [1, 2, 5, 10, 30, 60, 300, 600];
  const HISTORY_SPANS_S = [30, 60, 300, 1800, 7200, Infinity];
  const HISTORY_MOST = 20000;
  const EVENTS_MOST = 300;
  const CHART_HEIGHT = 170;

  const byId = (id) => document.getElementById(id);
  const element = (name, text, className) => {
    const made = document.createElement(name);
    if (text !== undefined) made.textContent = text;
    if (className) made.className = className;
    return made;
  };

  let socket = null;
  let device = null;
  let paused = false;
  let changed = false;
  let tableChanged = null;
  let signals = null;
  let history = null;
  let marks = [];
  let charts = [];
  let spanS = 5;
  let historySpanS = 60;
  let nowS = 0;

  const clear = () => {
    signals = { t: [], force: [[], []], position: [[], []], terminal: [[], []] };
    history = { t: [], quantities: Array.from({ length: 5 }, () => [[], []]) };
    marks = [];
    byId("events").replaceChildren();
  };

  // Colours come from the style sheet, so that light and dark have one definition.
  const colour = (name) => {
    const probe = element("span");
    probe.style.color = `var(--${name})`;
    document.body.append(probe);
    const found = getComputedStyle(probe).color;
    probe.remove();
    return found;
  };

  // To the digits that the interval bears, as the program prints them.
  const decimals = (u95) => Math.min(9, Math.max(0, 1 - Math.floor(Math.log10(u95))));
  const interval = (value, u95) => {
    if (value === null || value === undefined) return "–";
    if (!(u95 > 0)) return value.toFixed(4);
    if (u95 < 1e-5) {
      const exponent = Math.floor(Math.log10(Math.max(Math.abs(value), u95)));
      const [part, parts] = [value, u95].map((number) => number / 10 ** exponent);
      return `(${part.toFixed(decimals(parts))} ± ${parts.toFixed(decimals(parts))})e${exponent}`;
    }
    const digits = decimals(u95);
    return `${value.toFixed(digits)} ± ${u95.toFixed(digits)}`;
  };
  // With two decimals, or two digits.
  const amount = (value) => {
    if (value === 0) return "0.00";
    if (Math.abs(value) < 1e-5) return value.toExponential(1);
    return value.toFixed(Math.max(2, 1 - Math.floor(Math.log10(Math.abs(value)))));
  };
  const words = (status) => (status === "below_u95" ? "maybe none" : status.replaceAll("_", " "));
  const duration = (s) => (s < 120 ? `${s.toFixed(1)} s` : `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`);

  const markPlugin = () => ({
    hooks: {
      drawAxes: (plot) => {
        const { ctx, bbox } = plot;
        ctx.save();
        ctx.strokeStyle = ctx.fillStyle = colour("doubtful");
        ctx.lineWidth = devicePixelRatio;
        ctx.textAlign = "left";
        ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
        for (const [at, text] of marks) {
          const x = plot.valToPos(at, "x", true);
          if (x < bbox.left || x > bbox.left + bbox.width) continue;
          ctx.beginPath();
          ctx.moveTo(x, bbox.top);
          ctx.lineTo(x, bbox.top + bbox.height);
          ctx.stroke();
          ctx.fillText(text.slice(0, 24), x + 3 * devicePixelRatio, bbox.top + 10 * devicePixelRatio);
        }
        ctx.restore();
      },
    },
  });

  // One chart; `data` gives times, low, high and, for parameters, the value.
  const addChart = (place, title, data, isHistory) => {
    const card = element("div", undefined, "chart");
    const heading = element("h2", title);
    const more = element("small");
    heading.append(" ", more);
    const body = element("div");
    card.append(heading, body);
    byId(place).append(card);
    const chart = { body, data, isHistory, more, zoomed: false, plot: null };
    charts.push(chart);
    return chart;
  };

  const makePlot = (chart) => {
    chart.plot?.destroy();
    const axis = () => ({
      stroke: colour("quiet"),
      grid: { stroke: colour("line"), width: 1 },
      ticks: { stroke: colour("line"), width: 1 },
      font: "12px system-ui, sans-serif",
    });
    const edge = { stroke: chart.isHistory ? "transparent" : colour("curve"), width: 1, points: { show: false } };
    const series = [{}, edge, edge];
    if (chart.isHistory) series.push({ stroke: colour("curve"), width: 2, points: { show: false } });
    const options = {
      width: Math.max(120, chart.body.clientWidth),
      height: CHART_HEIGHT,
      legend: { show: false },
      cursor: { drag: { x: true, y: false }, bind: { dblclick: (plot, target, handler) => (event) => { chart.zoomed = false; changed = true; return handler(event); } } },
      scales: { x: { time: false } },
      axes: [{ ...axis(), size: 32, values: (plot, splits) => splits.map((s) => `${+s.toFixed(3)} s`) }, { ...axis(), size: 62 }],
      series,
      bands: [{ series: [2, 1], fill: colour(chart.isHistory ? "band" : "curve") }],
      plugins: [markPlugin()],
      hooks: { setSelect: [(plot) => { if (plot.select.width > 0) chart.zoomed = true; }] },
    };
    chart.plot = new uPlot(options, chart.data(), chart.body);
  };

  const lowerBound = (list, value) => {
    let [low, high] = [0, list.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (list[middle] < value) low = middle + 1; else high = middle;
    }
    return low;
  };

  // Ranges of a signal with a hole where samples are missing.
  const signalData = (name) => () => {
    const start = lowerBound(signals.t, nowS - spanS * 1.1);
    const [times, low, high] = [[], [], []];
    for (let place = start; place < signals.t.length; place++) {
      const t = signals.t[place];
      if (times.length && t - times.at(-1) > 0.1) {
        times.push((t + times.at(-1)) / 2);
        low.push(null);
        high.push(null);
      }
      times.push(t);
      low.push(signals[name][0][place]);
      high.push(signals[name][1][place]);
    }
    return [times, low, high];
  };

  const historyData = (quantity, factor) => () => {
    const start = Number.isFinite(historySpanS) ? lowerBound(history.t, nowS - historySpanS * 1.1) : 0;
    const [values, u95s] = history.quantities[quantity].map((list) => list.slice(start));
    const side = (sign) => values.map((value, place) => (value === null ? null : value + sign * (u95s[place] ?? 0)));
    return [history.t.slice(start), side(-1), side(1), values];
  };

  const build = () => {
    for (const chart of charts) chart.plot?.destroy();
    charts = [];
    byId("signals").replaceChildren();
    byId("parameters").replaceChildren();
    const [force, position, terminal] = [1, 0, 2].map((place) => device.signals[place]);
    addChart("signals", force, signalData("force"), false);
    addChart("signals", position, signalData("position"), false);
    if (device.terminal) addChart("signals", terminal, signalData("terminal"), false);
    device.parameters.forEach((field, place) => addChart("parameters", `${field.label} [${field.unit}]`, historyData(place), true));
    addChart("parameters", `Backlash [${device.backlash_unit}]`, historyData(4), true);
    byId("memory").textContent = `last ${device.memory_s} s`;
    charts.forEach(makePlot);
  };

  const draw = () => {
    for (const chart of charts) {
      if (!chart.plot) continue;
      const span = chart.isHistory ? historySpanS : spanS;
      const min = Number.isFinite(span) ? nowS - span : history.t[0] ?? 0;
      const data = chart.data();
      chart.plot.setData(data, false);
      if (chart.isHistory) {
        const [low, value] = [data[1].at(-1), data[3].at(-1)];
        chart.more.textContent = value === null || value === undefined ? "not identifiable" : interval(value, value - low);
      }
      if (chart.zoomed) chart.plot.redraw();
      else chart.plot.setScale("x", { min, max: Math.max(nowS, min + 0.1) });
    }
  };

  const row = (label, unit, recent, status, whole) => {
    const made = element("tr");
    const name = element("th", `${label} `);
    name.scope = "row";
    name.append(element("span", unit, "unit"));
    made.append(name, element("td", recent), element("td", words(status), status), element("td", whole));
    return made;
  };

  const table = (estimate) => {
    if (!device) return;
    const show = (parameter) => (parameter.value === null ? "–" : interval(parameter.value, parameter.u95));
    const rows = device.parameters.map((field) =>
      row(field.label, field.unit, show(estimate[field.path]), estimate[field.path].status, show(estimate.whole_run[field.path])));
    const backlash = estimate.backlash_m;
    if (backlash) {
      const shown = backlash.value === null ? "–" : interval(backlash.value * 1e6, backlash.u95 * 1e6);
      rows.push(row("Backlash", device.backlash_unit, backlash.reason ? words(backlash.reason) : "", backlash.status, shown));
    }
    for (const { path: key, label, unit } of device.contact) {
      if (estimate[key]) rows.push(row(label, unit, "", estimate[key].status, show(estimate[key])));
    }
    byId("table").replaceChildren(...rows);
    const residual = estimate.residual_rms_n === null ? "" : `, residual ${amount(estimate.residual_rms_n)} ${device.force_unit}`;
    byId("state").textContent = `${duration(estimate.t_s)}, ${estimate.moving ? "moving" : "at rest"}${residual}. ${estimate.state ?? ""}`;
  };

  const event = (at, text, className) => {
    const line = element("li");
    line.append(element("time", `${at.toFixed(2)} s `), element("span", text, className));
    byId("events").prepend(line);
    while (byId("events").childElementCount > EVENTS_MOST) byId("events").lastElementChild.remove();
  };

  const trim = (list, count) => list.splice(0, count);
  const handlers = {
    begin: (message) => {
      clear();
      nowS = 0;
      byId("marker-text").placeholder = message.recording ? `Marker, also into ${message.recording}` : "Marker";
    },
    device: (message) => {
      const anew = !device || device.terminal !== message.terminal || device.force_unit !== message.force_unit || charts.length === 0;
      device = message;
      byId("device").textContent = `${message.board} ${message.serial}, ${message.sample_rate_hz} Hz, ${message.port}`;
      byId("memory").textContent = `last ${message.memory_s} s`;
      if (anew) build();
    },
    samples: (message) => {
      // Times only ever grow: uPlot relies on it.
      const first = signals.t.length ? lowerBound(message.t_s, signals.t.at(-1) + 1e-9) : 0;
      signals.t.push(...message.t_s.slice(first));
      for (const [name, key] of [["force", "force_n"], ["position", "position_mm"], ["terminal", "terminal_mm"]]) {
        [0, 1].forEach((side) => message[key] && signals[name][side].push(...message[key][side].slice(first)));
      }
      if (!signals.t.length) return;
      const old = lowerBound(signals.t, signals.t.at(-1) - SIGNALS_S);
      // Not at each message: to shift a long list takes time.
      if (old > 1000) {
        trim(signals.t, old);
        for (const name of ["force", "position", "terminal"]) signals[name].forEach((list) => trim(list, old));
      }
    },
    history: (message) => {
      history = { t: message.t_s, quantities: message.quantities };
    },
    estimate: (message) => {
      if (!(history.t.at(-1) >= message.run_s)) {
        history.t.push(message.run_s);
        device?.parameters.forEach((field, place) => {
          history.quantities[place][0].push(message[field.path].value);
          history.quantities[place][1].push(message[field.path].u95);
        });
        const micro = (value) => (value === null || value === undefined ? null : value * 1e6);
        history.quantities[4][0].push(micro(message.backlash_m?.value));
        history.quantities[4][1].push(micro(message.backlash_m?.u95));
        if (history.t.length > HISTORY_MOST) {
          const odd = (list) => list.filter((_, place) => place % 2 === 0);
          history = { t: odd(history.t), quantities: history.quantities.map((sides) => sides.map(odd)) };
        }
      }
      tableChanged = message;
    },
    health: (message) => {
      byId("health").textContent = message.words;
      byId("health").className = message.clean ? "ok" : "bad";
      const rows = Object.entries(message).filter(([key]) => !["kind", "clean", "words"].includes(key)).map(([key, value]) => {
        const made = element("tr");
        made.append(element("th", key.replaceAll("_", " ")), element("td", value === null ? "not known" : `${+(+value).toFixed(2)}`));
        return made;
      });
      byId("health-table").replaceChildren(...rows);
    },
    event: (message) => event(message.run_s, message.words, message.trouble ? "bad" : ""),
    marker: (message) => {
      marks.push([message.run_s, message.text]);
      if (marks.length > EVENTS_MOST) marks.shift();
      event(message.run_s, `marker: ${message.text}`, "held");
    },
    away: (message) => link(message.reason),
    back: () => link(""),
  };

  const link = (text) => {
    byId("link").textContent = text;
    byId("link").hidden = !text;
  };

  const connect = () => {
    socket = new WebSocket(`ws://${location.host}${location.pathname}live`);
    socket.onopen = () => link("");
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      handlers[message.kind]?.(message);
      changed = true;
    };
    socket.onclose = () => {
      link("the monitor has ended or cannot be reached; trying again");
      setTimeout(connect, 1000);
    };
  };
  const ask = (wish) => socket?.readyState === WebSocket.OPEN && socket.send(JSON.stringify(wish));

  byId("pause").onclick = () => {
    paused = !paused;
    byId("pause").setAttribute("aria-pressed", paused);
    byId("pause").textContent = paused ? "Continue" : "Pause";
    changed = true;
  };
  byId("marker").onsubmit = (submitted) => {
    submitted.preventDefault();
    ask({ marker: byId("marker-text").value });
    byId("marker-text").value = "";
  };
  byId("reset").onclick = () => {
    if (confirm("Forget all motion seen so far and restart the estimates?")) ask({ reset_estimator: true });
  };
  const choose = (id, spans, chosen, set) => {
    const label = (s) => (Number.isFinite(s) ? (s < 120 ? `${s} s` : `${s / 60} min`) : "all");
    spans.forEach((s, place) => byId(id).append(new Option(label(s), place, s === chosen, s === chosen)));
    byId(id).onchange = () => {
      set(spans[byId(id).value]);
      charts.forEach((chart) => { chart.zoomed = false; });
      changed = true;
    };
  };
  choose("span", SPANS_S, spanS, (s) => { spanS = s; });
  choose("history-span", HISTORY_SPANS_S, historySpanS, (s) => { historySpanS = s; });
  new ResizeObserver(() => charts.forEach((chart) => chart.plot?.setSize({ width: Math.max(120, chart.body.clientWidth), height: CHART_HEIGHT }))).observe(byId("parameters"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach(makePlot));

  // Drawn 20 times a second at most, and only when something is new and the page is looked at.
  let drawnAt = 0;
  const turn = (at) => {
    if (changed && at - drawnAt >= 50) {
      drawnAt = at;
      changed = false;
      if (!paused) {
        nowS = Math.max(signals.t.at(-1) ?? 0, history.t.at(-1) ?? 0);
        if (tableChanged) table(tableChanged);
      }
      draw();
    }
    requestAnimationFrame(turn);
  };
  clear();
  connect();
  requestAnimationFrame(turn);
})();
