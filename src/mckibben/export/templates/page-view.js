// Drawing, charts and sliders; `simulated` of a worker or, where there is none, of this page computes the runs.
(function () {
    "use strict";
    const $ = id => document.getElementById(id), D = SETTINGS.drawing, A = SETTINGS.angle, K = SETTINGS.stiffness;
    const COLOURS = ["#440154", "#46337f", "#365d8d", "#26818e", "#20a386", "#50c46a", "#a8db34"];
    const values = Object.fromEntries(SETTINGS.sliders.map(slider => [slider.name, slider.nominal]));
    let knows = false, mode = "run", shown = null, at = 0, playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    const shownUnit = unit => unit === "1" ? "" : unit.replace("deg", "°").replaceAll("*", "·");
    const minus = text => text.replace("-", "−"), finite = Number.isFinite;
    const digits = (value, count) => finite(value) ? minus(value === 0 ? "0" : Number(value.toPrecision(count)).toString()) : "–";

    // ---- runs
    const later = {busy: false, again: false};
    let worker = (() => {
        try {
            const text = `${$("program").textContent}onmessage = ({data}) => postMessage(shownRun(data.values, data.knows));`;
            return new Worker(URL.createObjectURL(new Blob([text], {type: "text/javascript"})));
        } catch { return null; }
    })();
    if (worker) {
        worker.onmessage = ({data}) => { later.busy = false; show(data); if (later.again) compute(); };
        worker.onerror = () => { worker = null; later.busy = false; compute(); };
    }
    function compute() {
        if (mode === "live") return begin();
        if (later.busy) { later.again = true; return; }
        later.again = false;
        document.body.classList.add("waiting");
        if (worker) { later.busy = true; worker.postMessage({values, knows}); return; }
        show(shownRun(values, knows));
    }
    function show(run) {
        document.body.classList.remove("waiting");
        if (mode === "live") return;
        shown = run;
        const seconds = SETTINGS.periods * SETTINGS.period;
        $("cost").textContent = `${seconds} s in ${SETTINGS.periods.toLocaleString("en")} control periods, computed in ${run.ms.toFixed(0)} ms by this browser.`;
        scales();
        verdict();
        draw();
    }

    // ---- live: the joint moves in real time, and the visitor is the reference
    let live = null, target = 0, stiffness = 0, last = 0;
    const WINDOW = Math.round(10 / SETTINGS.period);
    function begin() {
        const self = adjusted(values, knows), wanted = setpoints(self, 1);
        if (!live) { target = wanted.angle[0]; stiffness = wanted.stiffness[0]; }
        const exists = PROGRAM.init(self, {angle: target, stiffness});
        const columns = Object.fromEntries(SETTINGS.columns.map(name => [name, new Float64Array(WINDOW).fill(NaN)]));
        const every = 25, count = Math.ceil(WINDOW / every);
        const band = {low: new Float64Array(count).fill(NaN), high: new Float64Array(count).fill(NaN)};
        live = {self, count: 0, change: {at: 0, before: stiffness, after: stiffness, ends: 0}};
        shown = {columns, exists, band, every, metrics: {}, outcome: exists ? "COMPLETED" : "NO_START"};
        last = performance.now();
        $("cost").textContent = "The joint moves in real time, and you are its reference.";
        scales();
        verdict();
        draw();
    }
    function advance(now) {
        const due = Math.min(Math.round((now - last) / 1000 / SETTINGS.period), Math.round(0.06 / SETTINGS.period));
        last = now - last > 200 ? now : last + due * SETTINGS.period * 1000;
        if (!shown.exists || due < 1) return;
        for (const column of Object.values(shown.columns)) column.copyWithin(0, due);
        const run = {index: 1, periods: 1e9};
        for (let k = WINDOW - due; k < WINDOW; k++) {
            const seen = PROGRAM.step(live.self, {angle: target, stiffness}, run, live.change).seen;
            for (const name of SETTINGS.columns) shown.columns[name][k] = seen[name];
            if (live.count++ % shown.every === 0) {
                const found = PROGRAM.attainable(live.self, target).band, {low, high} = shown.band;
                low.copyWithin(0, 1);
                high.copyWithin(0, 1);
                low[low.length - 1] = found.lowest;
                high[high.length - 1] = found.highest;
            }
        }
        at = WINDOW - 1;
    }

    // ---- verdict
    const GRADES = {COMPLETED: "good", SATURATED: "good"};
    function verdict() {
        const text = $("verdict").querySelector("b"), m = shown.metrics, outcome = shown.outcome;
        text.className = GRADES[outcome] || "severe";
        let words = SETTINGS.outcomes[outcome];
        if (mode === "live") {
            const i = WINDOW - 1, limited = shown.columns.saturated[i], slack = shown.columns.slack[i];
            if (shown.exists) words = slack ? "a muscle is slack" : limited ? "a command is at a pressure limit" : "follows you";
            if (limited || slack) text.className = "warning";
        } else if (!shown.exists) {
            const {low, high} = shown.band;
            words += low[0] <= high[0] ? `; attainable there: ${digits(low[0] / K.scale, 3)} to ${digits(high[0] / K.scale, 3)} ${shownUnit(K.unit)}` : "; no stiffness is attainable there";
        } else {
            const wanted = shown.columns.desired_stiffness;
            let outside = 0;
            shown.band.low.forEach((low, i) => { const k = wanted[i * shown.every]; if (!(k >= low && k <= shown.band.high[i])) outside++; });
            if (outside && finite(wanted[0])) {
                words = `the reference is not attainable for ${Math.ceil(100 * outside / shown.band.low.length)} % of the time; ${words}`;
                text.className = "severe";
            }
        }
        text.textContent = words[0].toUpperCase() + words.slice(1);
        const facts = mode === "live" ? {} : {
            [`${A.name}, RMS error`]: `${digits(m.angle_rmse / A.scale, 2)} ${shownUnit(A.unit)}`,
            ...(K.isAsked ? {"stiffness, RMS error": `${digits(m.stiffness_rmse / K.scale, 2)} ${shownUnit(K.unit)}`} : {}),
            "command travel": `${digits(m.command_travel / 1e5, 2)} bar/s`,
            "air": `${digits(m.air * 1e3, 2)} L`,
        };
        $("verdict").querySelector("dl").replaceChildren(...Object.entries(facts).map(([name, value]) => {
            const entry = document.createElement("div");
            entry.innerHTML = "<dt></dt><dd></dd>";
            entry.firstChild.textContent = name;
            entry.lastChild.textContent = value;
            return entry;
        }));
    }

    // ---- joint: points of the mechanism
    const NS = "http://www.w3.org/2000/svg", svg = $("joint");
    const el = (name, attributes, parent = svg) => {
        const made = document.createElementNS(NS, name);
        for (const key in attributes) made.setAttribute(key, attributes[key]);
        parent.append(made);
        return made;
    };
    const WIDE = 1.4, BESIDE = 60;
    const xy = point => point.map(number => number.toFixed(1)).join(" ");
    const path = points => points.length ? "M" + points.map(xy).join("L") : "";
    function between(table, x) {
        const n = table.length - 1, i = Math.min(Math.max(table.findIndex(edge => edge >= x) - 1, 0), n - 1);
        const k = x >= table[n] ? n - 1 : i;
        return [k, Math.min(Math.max((x - table[k]) / (table[k + 1] - table[k]), 0), 1)];
    }
    const mix = (a, b, f) => Array.isArray(a) ? a.map((one, i) => mix(one, b[i], f)) : a + f * (b - a);
    const size = (muscle, contraction, what) => { const [k, f] = between(muscle.contractions, contraction); return mix(muscle[what][k], muscle[what][k + 1], f); };
    function outline(first, last, width) {
        const dx = last[0] - first[0], dy = last[1] - first[1], l = Math.hypot(dx, dy), h = width / 2, e = 0.45 * h, c = Math.min(0.9 * width, l / 3);
        const p = (s, t) => xy([first[0] + (dx * s - dy * t) / l, first[1] + (dy * s + dx * t) / l]);
        return `M${p(0, e)}C${p(0, h)} ${p(c / 2, h)} ${p(c, h)}L${p(l - c, h)}C${p(l - c / 2, h)} ${p(l, h)} ${p(l, e)}L${p(l, -e)}C${p(l, -h)} ${p(l - c / 2, -h)} ${p(l - c, -h)}L${p(c, -h)}C${p(c / 2, -h)} ${p(0, -h)} ${p(0, -e)}Z`;
    }
    function coil(first, last, width) {
        const dx = last[0] - first[0], dy = last[1] - first[1], l = Math.hypot(dx, dy);
        return path(Array.from({length: 21}, (_, i) => { const t = i % 20 ? (i % 2 ? 1 : -1) * width / 2 / l : 0; return [first[0] + dx * i / 20 - dy * t, first[1] + dy * i / 20 + dx * t]; }));
    }
    function colour(share) {
        const x = Math.min(Math.max(share, 0), 1) * 6, i = Math.min(Math.floor(x), 5), f = x - i;
        const rgb = k => [1, 3, 5].map(j => parseInt(COLOURS[k].slice(j, j + 2), 16));
        return `rgb(${mix(rgb(i), rgb(i + 1), f).map(Math.round)})`;
    }
    const TOP = Math.max(...D.muscles.map(muscle => muscle.highest));
    const points = [D.thick, D.thin, D.strands.map(pair => pair.filter(Boolean).map(strand => [strand.start, strand.end])), [[D.tips]]].flat(3);
    const [top, bottom] = [Math.min, Math.max].map(end => end(...points.map(point => point[1])));
    const spare = bottom - top, [left, right] = [Math.min, Math.max].map((end, i) => end(...points.map(point => point[0]), (i - 0.5) * 0.6 * spare));
    const scaleHigh = Math.min(420, Math.max(bottom - top, 240)), middle = (top + bottom) / 2;
    const U = Math.max(1, Math.max(right - left + 300, bottom - top + 220) / 1800), TEXT = 54 * U;  // of text
    svg.setAttribute("viewBox", [left - 80, Math.min(top, middle - scaleHigh / 2) - 130 * U, right - left + 80 + 220 * U, Math.max(bottom - top, scaleHigh) + 220 * U].join(" "));
    const scale = el("linearGradient", {id: "scale", x1: 0, x2: 0, y1: 1, y2: 0}, el("defs", {}));
    COLOURS.forEach((c, i) => el("stop", {offset: i / 6, "stop-color": c}, scale));
    const line = (width, colour) => el("path", {"stroke-width": width, stroke: `var(--${colour})`, fill: "none", "stroke-linecap": "round", "stroke-linejoin": "round"});
    const cams = D.cams[0].map(() => el("path", {fill: "var(--plate)"})), thin = line(34, "bone");
    const goal = el("path", {stroke: "var(--accent)", "stroke-width": 8, "stroke-dasharray": "22 18", fill: "none"});
    const thick = line(52, "bone"), cables = D.muscles.map(() => line(10, "cable"));
    const bodies = D.muscles.map(() => el("path", {stroke: "var(--text)", "stroke-width": 3.5}));
    const masses = D.masses[0].map(() => el("circle", {r: 32, fill: "var(--weight)"}));
    for (const [cx, cy] of D.pivots) el("circle", {cx, cy, r: 24, fill: "var(--panel)", stroke: "var(--text)", "stroke-width": 6});
    const notes = D.muscles.map((_, i) => el("text", {"font-size": TEXT, fill: `var(--muscle${i + 1})`, "font-weight": 600}));
    const note = el("text", {"font-size": TEXT, fill: "var(--text)", x: left - 60, y: Math.min(top, middle - scaleHigh / 2) - 70 * U, "font-weight": 600});
    const low = middle + scaleHigh / 2, end = right + 170 * U;
    el("rect", {x: end, y: low - scaleHigh, width: 34, height: scaleHigh, rx: 10, fill: "url(#scale)"});
    [TOP, TOP / 2, 0].forEach((p, i) => { el("text", {x: end - 15, y: low - scaleHigh * (1 - i / 2) + 14, "font-size": 38 * U, fill: "var(--quiet)", "text-anchor": "end"}).textContent = `${p / 1e5}${i ? "" : " bar"}`; });
    const range = [D.angles[0], D.angles[D.angles.length - 1]];
    const handle = el("circle", {r: 46, fill: "var(--accent)", "fill-opacity": 0.22, stroke: "var(--accent)", "stroke-width": 8, tabindex: 0, role: "slider",
        "aria-label": `desired ${A.name} in ${A.unit}`, "aria-valuemin": (range[0] / A.scale).toFixed(0), "aria-valuemax": (range[1] / A.scale).toFixed(0), style: "cursor:grab;touch-action:none"});
    const at_ = (table, angle) => { const [k, f] = between(D.angles, angle); return mix(table[k], table[k + 1], f); };
    function muscleDrawn(s, strand, c, i) {
        const muscle = D.muscles[s], contraction = c[`contraction${s + 1}`][i] || 0, pressure = c[`pressure${s + 1}`][i];
        const dx = strand.end[0] - strand.start[0], dy = strand.end[1] - strand.start[1], whole = Math.hypot(dx, dy);
        const length = muscle.spring ? whole : size(muscle, contraction, "lengths"), width = WIDE * (muscle.widths ? size(muscle, contraction, "widths") : 0.07 * length);
        const lead = strand.wrap.length ? 0 : Math.max(whole - length, 0) / 2 / whole, share = Math.min(length / whole, 1);
        const place = t => [strand.start[0] + dx * t, strand.start[1] + dy * t], first = place(lead), last = place(Math.min(lead + share, 1));
        cables[s].setAttribute("d", path([strand.start, first]) + path([last, strand.end, ...strand.wrap]));
        bodies[s].setAttribute("d", muscle.spring ? coil(first, last, width) : outline(first, last, width));
        bodies[s].setAttribute("fill", muscle.spring ? "none" : finite(pressure) ? colour(pressure / TOP) : "var(--bone)");
        const [x, y] = place(lead + share / 2), upright = Math.abs(dy) > Math.abs(dx), side = x < 0 ? -1 : 1;
        notes[s].setAttribute("text-anchor", upright ? (side < 0 ? "end" : "start") : "middle");
        notes[s].setAttribute("x", upright ? x + side * BESIDE : x);
        notes[s].setAttribute("y", upright ? y + (s ? 50 : -20) : y - BESIDE);
        notes[s].textContent = finite(pressure) && !muscle.spring ? `${(pressure / 1e5).toFixed(2)} bar` : "";
    }
    function pose() {
        const c = shown.columns, i = Math.min(at, c.angle.length - 1), wanted = mode === "live" ? target : c.desired_angle[i];
        const angle = finite(c.angle[i]) ? c.angle[i] : wanted || 0, [k, f] = between(D.angles, angle);
        thick.setAttribute("d", at_(D.thick, angle).map(path).join(""));
        thin.setAttribute("d", at_(D.thin, angle).map(path).join(""));
        at_(D.cams, angle).forEach((cam, s) => cams[s].setAttribute("d", path(cam) + "Z"));
        at_(D.masses, angle).forEach(([x, y], m) => { masses[m].setAttribute("cx", x); masses[m].setAttribute("cy", y); });
        D.strands[k].forEach((strand, s) => {
            if (strand) muscleDrawn(s, Object.fromEntries(["start", "end", "wrap"].map(key => [key, mix(strand[key], D.strands[k + 1][s][key], f)])), c, i);
        });
        goal.setAttribute("d", finite(wanted) ? path(at_(D.moving, wanted)) : "");
        const [x, y] = at_(D.tips, finite(wanted) ? wanted : angle);
        handle.setAttribute("cx", x);
        handle.setAttribute("cy", y);
        handle.setAttribute("aria-valuenow", ((wanted || 0) / A.scale).toFixed(1));
        note.textContent = minus(`${A.name} ${(angle / A.scale).toFixed(2)} ${shownUnit(A.unit)}`);
    }
    function setTarget(angle) {
        if (mode !== "live") setMode("live");
        target = Math.min(Math.max(angle, range[0]), range[1]);
    }
    function pointed(event) {  // to the angle whose tip is nearest
        const {x, y} = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
        let nearest = Infinity, angle = target;
        for (let k = 0; k + 1 < D.tips.length; k++) {
            const [x0, y0] = D.tips[k], dx = D.tips[k + 1][0] - x0, dy = D.tips[k + 1][1] - y0;
            const f = Math.min(Math.max(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0), 1);
            const distance = Math.hypot(x - x0 - f * dx, y - y0 - f * dy);
            if (distance < nearest) [nearest, angle] = [distance, mix(D.angles[k], D.angles[k + 1], f)];
        }
        setTarget(angle);
    }
    handle.addEventListener("pointerdown", event => { handle.setPointerCapture(event.pointerId); event.preventDefault(); pointed(event); });
    handle.addEventListener("pointermove", event => { if (handle.hasPointerCapture(event.pointerId)) pointed(event); });
    handle.addEventListener("keydown", event => {
        const change = {ArrowLeft: -0.5, ArrowDown: -0.5, ArrowRight: 0.5, ArrowUp: 0.5}[event.key];
        if (change) { event.preventDefault(); setTarget((mode === "live" ? target : shown.columns.desired_angle[at] || 0) + change * A.scale); }
    });

    // ---- charts
    const MUSCLES = [1, 2].filter(n => !D.muscles[n - 1].spring);
    const CHARTS = [
        {title: `${A.name[0].toUpperCase()}${A.name.slice(1)} [${shownUnit(A.unit)}]`, unit: A.scale, least: 1.5, lines: [["angle", "measured", "joint"], ["desired_angle", "text", "desired", true]]},
        {title: `Stiffness [${shownUnit(K.unit)}]`, unit: K.scale, least: 1, band: K.isAsked, lines: [["stiffness", "measured", "joint"], ...(K.isAsked ? [["desired_stiffness", "text", "desired", true]] : [])]},
        {title: "Pressure [bar]", unit: 1e5, least: 0.3, lines: [
            ...MUSCLES.map((n, i) => [`command${n}`, "quiet", i ? "" : "commands", true]), ...MUSCLES.map(n => [`pressure${n}`, `muscle${n}`, `muscle ${n}`])]},
    ];
    for (const chart of CHARTS) {
        const panel = document.createElement("div"), head = document.createElement("h2");
        panel.className = "panel chart";
        head.textContent = chart.title;
        const legend = (text, colour, kind) => { const item = document.createElement("i"); item.textContent = text; item.className = kind; item.style.setProperty("--c", `var(--${colour})`); head.append(item); };
        if (chart.band) legend("attainable at rest", "band", "area");
        for (const [, colour, text, dashed] of chart.lines) if (text) legend(text, colour, dashed ? "dashed" : "");
        chart.canvas = document.createElement("canvas");
        panel.append(head, chart.canvas);
        $("charts").append(panel);
        const scrub = event => {
            if (mode === "live" || !shown) return;
            playing = false;
            at = Math.min(Math.max(chart.index(event.offsetX), 0), SETTINGS.periods - 1);
            label();
            draw();
        };
        chart.canvas.addEventListener("pointerdown", event => { chart.held = true; chart.canvas.setPointerCapture(event.pointerId); scrub(event); });
        chart.canvas.addEventListener("pointermove", event => { if (chart.held) scrub(event); });
        for (const end of ["pointerup", "pointercancel"]) chart.canvas.addEventListener(end, () => { chart.held = false; });
    }
    function scales() {
        for (const chart of CHARTS) {
            let low = Infinity, high = -Infinity;
            const sees = (value, i) => { if (finite(value)) { low = Math.min(low, value / chart.unit); high = Math.max(high, value / chart.unit); } };
            for (const [name] of chart.lines) if (!name.startsWith("command")) shown.columns[name].forEach(sees);
            if (chart.band && low < high) { const wide = high - low; for (const edge of [shown.band.low, shown.band.high]) edge.forEach(v => { if (finite(v) && v / chart.unit > low - 2 * wide - 2 && v / chart.unit < high + 2 * wide + 2) sees(v); }); }
            if (mode === "live") {
                if (chart === CHARTS[0]) [low, high] = range.map(angle => Math.min(Math.max(angle / A.scale, -30), 30));
                else if (chart === CHARTS[1]) [low, high] = [K.low / K.scale, K.high / K.scale];
                else [low, high] = [0, TOP / 1e5];
            }
            if (!(low <= high)) [low, high] = [0, 1];
            const middle = (low + high) / 2, half = Math.max((high - low) / 2 * 1.12, chart.least);
            chart.range = [middle - half, middle + half];
        }
    }
    function nice(span) {
        const power = 10 ** Math.floor(Math.log10(span)), rest = span / power;
        return (rest < 1.5 ? 0.25 : rest < 3 ? 0.5 : rest < 7 ? 1 : 2) * power;
    }
    function plot(chart, isLast) {
        const {canvas, unit} = chart, ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
        if (!w) return;
        if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) { canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio); }
        const g = canvas.getContext("2d"), style = getComputedStyle(document.documentElement), tone = name => style.getPropertyValue(`--${name}`).trim();
        const n = shown.columns.angle.length, [low, high] = chart.range, L = 40, R = 10, T = 6, B = isLast ? 20 : 8;
        const X = i => L + (w - L - R) * i / Math.max(n - 1, 1), Y = v => T + (h - T - B) * (high - v) / (high - low);
        chart.index = x => Math.round((x - L) / (w - L - R) * (n - 1));
        g.setTransform(ratio, 0, 0, ratio, 0, 0);
        g.clearRect(0, 0, w, h);
        g.font = "11px system-ui, sans-serif";
        g.textBaseline = "middle";
        g.textAlign = "right";
        const step = nice((high - low) * (h < 130 ? 1.6 : 1));
        for (let v = Math.ceil(low / step) * step; v <= high + 1e-9; v += step) {
            g.strokeStyle = tone("line");
            g.lineWidth = 1;
            g.beginPath();
            g.moveTo(L, Math.round(Y(v)) + 0.5);
            g.lineTo(w - R, Math.round(Y(v)) + 0.5);
            g.stroke();
            g.fillStyle = tone("quiet");
            g.fillText(minus(String(Number(v.toFixed(3)))), L - 5, Y(v));
        }
        if (isLast) {
            const seconds = n * SETTINGS.period, every = nice(seconds) * 2;
            g.textAlign = "center";
            for (let t = 0; t <= seconds + 1e-9; t += every) g.fillText(mode === "live" ? `${minus(String(Number((t - seconds).toFixed(2))))} s` : `${Number(t.toFixed(2))}${t ? "" : " s"}`, Math.min(X(t / SETTINGS.period), w - 14), h - 8);
        }
        g.save();
        g.beginPath();
        g.rect(L, T - 2, w - L - R, h - T - B + 4);
        g.clip();
        if (chart.band) {
            const {low: lows, high: highs} = shown.band, place = i => X(i * shown.every);
            g.fillStyle = tone("band");
            for (let i = 0; i + 1 < lows.length; i++) {
                if (!(lows[i] <= highs[i] && lows[i + 1] <= highs[i + 1])) continue;
                g.beginPath();
                g.moveTo(place(i) - 0.3, Y(highs[i] / unit));
                g.lineTo(place(i + 1) + 0.3, Y(highs[i + 1] / unit));
                g.lineTo(place(i + 1) + 0.3, Y(lows[i + 1] / unit));
                g.lineTo(place(i) - 0.3, Y(lows[i] / unit));
                g.fill();
            }
        }
        for (const [name, colour, , dashed] of chart.lines) {
            const column = shown.columns[name], stride = Math.max(1, Math.floor(n / (w * 2)));
            g.strokeStyle = tone(colour);
            g.lineWidth = dashed ? 1.3 : 2;
            g.setLineDash(dashed ? [5, 4] : []);
            g.beginPath();
            let pen = false;
            for (let i = 0; i < n; i += stride) {
                const v = column[i] / unit;
                if (!finite(v)) { pen = false; continue; }
                if (pen) g.lineTo(X(i), Y(v)); else g.moveTo(X(i), Y(v));
                pen = true;
            }
            g.stroke();
        }
        g.setLineDash([]);
        g.restore();
        if (mode !== "live") {
            g.strokeStyle = tone("accent");
            g.lineWidth = 1.3;
            g.beginPath();
            g.moveTo(X(at), T);
            g.lineTo(X(at), h - B);
            g.stroke();
        }
    }
    function draw() {
        CHARTS.forEach((chart, i) => plot(chart, i === CHARTS.length - 1));
        pose();
        $("at").value = at;
        $("clock").textContent = mode === "live" ? "live" : `${(at * SETTINGS.period).toFixed(2)} s`;
    }

    // ---- controls
    function slider(name, {low, high, value, scale, unit}, changed) {
        const made = document.createElement("label"), input = document.createElement("input"), output = document.createElement("output");
        const write = () => { output.textContent = `${digits(input.value / scale, 3)} ${shownUnit(unit)}`; };
        Object.assign(input, {type: "range", min: low, max: high, step: (high - low) / 200, value});
        input.value = value;
        input.addEventListener("input", () => { write(); changed(Number(input.value)); });
        made.append(name, output, input);
        write();
        $("sliders").append(made);
        return made;
    }
    const words = name => name.split(".").slice(-2).join(" ").replace("reference ", "").replaceAll("_", " ");
    const inRun = [];
    for (const one of SETTINGS.sliders) {
        const made = slider(words(one.name), {...one, value: one.nominal}, value => { values[one.name] = value; compute(); });
        if (one.name.startsWith("reference.")) inRun.push(made);
    }
    const wanted = slider("desired stiffness", {...K, value: (K.low + K.high) / 2}, value => { stiffness = value; });
    if (SETTINGS.sliders.some(one => one.ofModel.length)) {
        const made = document.createElement("label");
        made.className = "wide";
        made.innerHTML = '<input type="checkbox"> the controller’s model has these values, too';
        made.firstChild.addEventListener("change", event => { knows = event.target.checked; compute(); });
        $("sliders").append(made);
    }
    function setMode(name) {
        mode = name;
        live = null;
        at = 0;
        playing = true;
        for (const button of ["run", "live"]) $(button).setAttribute("aria-pressed", button === mode);
        for (const made of inRun) made.hidden = mode === "live";
        wanted.hidden = mode !== "live" || !K.isAsked;
        $("time").hidden = mode === "live";
        $("time").style.display = mode === "live" ? "none" : "";
        compute();
        if (mode === "live" && K.isAsked) { const input = wanted.querySelector("input"); input.value = stiffness; input.dispatchEvent(new Event("input")); }
        label();
    }
    const label = () => { $("play").textContent = playing ? "Pause" : "Play"; };
    $("run").addEventListener("click", () => setMode("run"));
    $("live").addEventListener("click", () => setMode("live"));
    $("play").addEventListener("click", () => { playing = !playing; if (playing && at >= SETTINGS.periods - 1) at = 0; label(); });
    $("at").max = SETTINGS.periods - 1;
    $("at").addEventListener("input", () => { playing = false; at = Number($("at").value); label(); draw(); });
    function python() {
        const given = Object.fromEntries(SETTINGS.sliders.map(one => [one.name, values[one.name]]));
        if (SETTINGS.startsAtReference && shown) Object.assign(given, {[`start.${A.name}`]: shown.start.angle}, finite(shown.start.stiffness) ? {"start.stiffness": shown.start.stiffness} : {});
        return `from mckibben.scenario import Scenario, with_values\n\nscenario = Scenario.read("scenario.yaml")  # values in SI\nvalues = ${JSON.stringify(given, null, 4)}\nprint(with_values(scenario, values, model_follows=${knows ? '"all"' : "()"}).simulate())\n`;
    }
    $("copy").addEventListener("click", async () => {
        try { await navigator.clipboard.writeText(python()); $("copied").textContent = "Copied; scenario.yaml lies beside this page."; }
        catch { open().document.body.append(Object.assign(document.createElement("pre"), {textContent: python()})); }
    });
    new ResizeObserver(() => { if (shown) draw(); }).observe(CHARTS[0].canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (shown) draw(); });
    let before = 0, count = 0;
    function tick(now) {
        if (shown && mode === "live") {
            advance(now);
            if (count++ % 6 === 0) verdict();
            draw();
        } else if (shown && playing) {
            at += Math.round(Math.min(now - before, 100) / 1000 / SETTINGS.period);
            if (at >= SETTINGS.periods) at = 0;
            draw();
        }
        before = now;
        requestAnimationFrame(tick);
    }
    setMode("run");
    playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    label();
    requestAnimationFrame(tick);
    window.joint = {values, python, setTarget, setMode, get shown() { return shown; }};
})();
