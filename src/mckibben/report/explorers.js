// Sliders and charts of the explorers; mckibben's functions, emitted as JavaScript, compute the data.
const explorer = (function () {
    "use strict";
    const INK = "#1c2024", SOFT = "#59626b", LINE = "#d9dfe5", COLOURS = ["#00568a", "#a33b00", "#00684a"];

    function element(parent, name, attributes, text) {
        const made = document.createElementNS("http://www.w3.org/2000/svg", name);
        for (const key in attributes) made.setAttribute(key, attributes[key]);
        if (text !== undefined) made.textContent = text;
        return parent.appendChild(made);
    }

    function ticks(low, high, most) {
        const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
        const step = power * [1, 2, 5, 10].find((one) => one * power >= rough);
        const count = Math.floor(high / step + 1e-9) - Math.ceil(low / step - 1e-9) + 1;
        return Array.from({length: count}, (_, k) => (Math.ceil(low / step - 1e-9) + k) * step);
    }

    const show = (number) => String(Number(number.toPrecision(4))).replace("-", "−");

    // curves: {x, y, colour, dashed, dots, label, at}; bands: {x, low, high}; non-finite numbers are left out
    function chart(parent, title, x, y, curves, bands = []) {
        const width = Math.max(parent.width, 280), height = Math.min(300, Math.max(220, 0.5 * width));
        const ended = curves.some((one) => one.label && !(one.at >= 0));
        const left = 48, right = width - (ended ? 66 : 12), top = 26, bottom = height - 40;
        const svg = element(parent, "svg", {width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title});
        const shown = [...curves.flatMap((one) => one.y), ...bands.flatMap((one) => [...one.low, ...one.high])].filter(Number.isFinite);
        const least = Math.min(y.low ?? Infinity, ...shown.slice(0, 1)), low = shown.reduce((a, b) => Math.min(a, b), least);
        const high = Math.max(shown.reduce((a, b) => Math.max(a, b), y.high ?? -Infinity), low + 1e-9);
        const px = (v) => left + (v - x.low) / (x.high - x.low) * (right - left);
        const py = (v) => bottom - (v - low) / (high - low) * (bottom - top);
        const text = (tx, ty, words, more) => element(svg, "text", {x: tx, y: ty, fill: SOFT, "font-size": 12, ...more}, words);
        for (const v of ticks(x.low, x.high, width / 60)) {
            element(svg, "line", {x1: px(v), x2: px(v), y1: top, y2: bottom, stroke: LINE});
            text(px(v), bottom + 15, show(v), {"text-anchor": "middle"});
        }
        for (const v of ticks(low, high, 5)) {
            element(svg, "line", {x1: left, x2: right, y1: py(v), y2: py(v), stroke: LINE});
            text(left - 6, py(v) + 4, show(v), {"text-anchor": "end"});
        }
        text((left + right) / 2, height - 6, x.label, {"text-anchor": "middle"});
        text(2, 13, y.label, {fill: INK});
        for (const one of bands) {
            const at = one.x.map((_, k) => k).filter((k) => Number.isFinite(one.low[k]));
            const edge = [...at.map((k) => [one.x[k], one.high[k]]), ...at.reverse().map((k) => [one.x[k], one.low[k]])];
            element(svg, "polygon", {points: edge.map(([u, v]) => `${px(u)},${py(v)}`).join(" "), fill: COLOURS[0], "fill-opacity": 0.15});
        }
        const labels = [];
        curves.forEach((one, number) => {
            const points = one.x.map((u, k) => [u, one.y[k]]).filter((point) => point.every(Number.isFinite));
            const stroke = one.colour ?? COLOURS[number % COLOURS.length], dash = one.dashed ? {"stroke-dasharray": "6 4"} : {};
            if (one.dots) for (const [u, v] of points) element(svg, "circle", {cx: px(u).toFixed(1), cy: py(v).toFixed(1), r: 3, fill: one.dashed ? "none" : stroke, stroke});
            else element(svg, "polyline", {points: points.map(([u, v]) => `${px(u).toFixed(1)},${py(v).toFixed(1)}`).join(" "), fill: "none", stroke, "stroke-width": one.dashed ? 1.5 : 2, ...dash});
            const [u, v] = points.at(-1) ?? [], at = one.at ?? -1; // default place of the label: the last point
            if (at >= 0) text(px(one.x[at]), py(one.y[at]) + 4, one.label, {fill: stroke, stroke: "#fff", "stroke-width": 4, "paint-order": "stroke", "text-anchor": "middle"});
            else if (one.label && points.length) labels.push({words: one.label, fill: stroke, x: px(u), y: py(v)});
        });
        labels.sort((a, b) => b.y - a.y).forEach((one, k) => {
            one.y = Math.min(one.y, k ? labels[k - 1].y - 13 : bottom);
            text(one.x + 5, one.y + 4, one.words, {fill: one.fill});
        });
    }

    // Redraws when the explorer is opened, a slider is moved, or the width changes.
    function start(name, draw) {
        const root = document.getElementById(name), inputs = [...root.querySelectorAll("form input")];
        const charts = root.querySelector(".charts"), says = root.querySelector(".says");
        const values = (key) => Object.fromEntries(inputs.map((one) => [one.name, Number(one[key]) * one.dataset.factor]));
        let waiting = false, width = 0;
        function redraw() {
            waiting = false;
            for (const one of inputs) {
                const said = `${show(Number(one.value))} ${one.dataset.unit}`.trim();
                root.querySelector(`output[for="${one.id}"]`).textContent = said;
                one.setAttribute("aria-valuetext", said);
            }
            const drawn = document.createDocumentFragment();
            drawn.width = width = charts.clientWidth;
            says.textContent = draw(values("value"), values("defaultValue"), drawn);
            charts.replaceChildren(drawn);
        }
        function request() {
            if (root.open && !waiting) waiting = Boolean(requestAnimationFrame(redraw));
        }
        root.addEventListener("toggle", request);
        root.addEventListener("input", request);
        root.addEventListener("reset", () => setTimeout(request));
        new ResizeObserver(() => charts.clientWidth !== width && request()).observe(charts);
        request();
    }

    function made(module, values) {
        const self = module.defaults();
        Object.assign(self.parameters, values);
        module.prepare(self);
        return self;
    }

    const grid = (low, high, count) => Array.from({length: count}, (_, k) => low + (high - low) * k / (count - 1));

    function force(name, module, {contractions, pressures}) {
        const at = grid(...contractions, 141), x = {low: 100 * contractions[0], high: 100 * contractions[1], label: "contraction, %"};
        start(name, (values, first, charts) => {
            const [now, then] = [values, first].map((one) => made(module, one));
            const curve = (self, p, more) => ({x: at.map((e) => 100 * e), y: at.map((e) => module.force(self, e, p)), ...more});
            const highest = pressures.at(-1), curves = pressures.map((p) => curve(now, p, {colour: COLOURS[0]}));
            const slack = curves.at(-1).y.indexOf(0), level = 0.12 * Math.max(...curves.at(-1).y);
            curves.forEach((one, k) => {
                one.at = one.y.findIndex((f) => f < level);
                one.label = pressures[k] === highest ? `${highest / 1e5} bar` : String(pressures[k] / 1e5);
            });
            chart(charts, "Force over contraction", x, {low: 0, label: "force, N"}, [
                ...pressures.map((p) => curve(then, p, {colour: SOFT, dashed: true})),
                ...curves,
            ]);
            const end = slack < 0 ? "" : `, and none above ${(100 * at[slack]).toFixed(1)} % contraction`;
            return `At ${highest / 1e5} bar the muscle pulls with ${module.force(now, 0, highest).toFixed(0)} N at its initial length${end}.`;
        });
    }

    function attainable(name, module, {angles}) {
        const degrees = grid(...angles, 241), x = {low: angles[0], high: angles[1], label: "angle, °"};
        start(name, (values, first, charts) => {
            const [now, then] = [values, first].map((one) => {
                const self = made(module, one), found = degrees.map((a) => module.at(self, a * Math.PI / 180));
                return {x: degrees, low: found.map((one) => one.lowest), high: found.map((one) => one.highest)};
            });
            const curve = (of, key, more) => ({x: of.x, y: of[key], ...more});
            chart(charts, "Attainable stiffness over the angle", x, {low: 0, high: 20, label: "stiffness, N·m/rad"}, [
                curve(then, "high", {colour: SOFT, dashed: true}), curve(then, "low", {colour: SOFT, dashed: true}),
                curve(now, "high", {colour: COLOURS[0], label: "highest"}), curve(now, "low", {colour: COLOURS[0], label: "lowest"}),
            ], [now]);
            const held = degrees.filter((_, k) => Number.isFinite(now.low[k])), zero = degrees.indexOf(0);
            if (!held.length) return "No angle can be held.";
            const range = `${show(Math.round(held[0] * 10) / 10)}° to ${show(Math.round(held.at(-1) * 10) / 10)}°`;
            const at = Number.isFinite(now.low[zero]) ? `; at 0° the stiffness is ${now.low[zero].toFixed(1)} to ${now.high[zero].toFixed(1)} N·m/rad` : "";
            return `The joint can be held from ${range}${at}.`;
        });
    }

    // Plays rows of a run at equal times: the joint at the slider's time, or advancing in real time.
    function player(root, module, times) {
        const box = root.querySelector(".player");
        const [svg, button, slider, output] = ["svg", "button", "input", "output"].map((one) => box.querySelector(one));
        let self = null, rows = [], playing = false, began = 0;
        slider.max = times.length - 1;
        const low = [204, 217, 230], high = [213, 94, 0]; // colours of a muscle at zero and at the highest pressure
        function draw() {
            const k = Number(slider.value), row = rows[k];
            button.textContent = playing ? "Pause" : "Play";
            output.textContent = `${times[k].toFixed(2)} s`;
            slider.setAttribute("aria-valuetext", output.textContent);
            svg.replaceChildren();
            if (!row || !(Math.abs(row.angle) < Math.PI / 2)) return;
            const at = module.picture(self, row.angle, row.pressure1, row.pressure2), top = at.fixed_y1;
            svg.setAttribute("viewBox", [-0.7 * top, -1.05 * top, 1.4 * top, 1.75 * top].join(" "));
            const line = (a, b, stroke, width, cap = "round") => element(svg, "line", {
                x1: a[0], y1: -a[1], x2: b[0], y2: -b[1], stroke, "stroke-width": width, "stroke-linecap": cap});
            const limb = [0.6 * top * Math.sin(row.angle), -0.6 * top * Math.cos(row.angle)];
            line([0, top], [0, 0], LINE, 0.035 * top);
            line([0, 0], limb, LINE, 0.035 * top);
            line([at.fixed_x1, top], [at.fixed_x2, top], SOFT, 0.015 * top);
            line([at.moving_x1, at.moving_y1], [at.moving_x2, at.moving_y2], SOFT, 0.015 * top);
            const most = Math.max(...rows.map((one) => Math.max(one.pressure1, one.pressure2)));
            for (const i of [1, 2]) {
                const a = [at[`fixed_x${i}`], at[`fixed_y${i}`]], b = [at[`moving_x${i}`], at[`moving_y${i}`]];
                const part = at[`length${i}`] / Math.hypot(b[0] - a[0], b[1] - a[1]);
                const on = (s) => a.map((one, axis) => one + s * (b[axis] - one));
                const colour = low.map((one, c) => Math.round(one + row[`pressure${i}`] / most * (high[c] - one)));
                line(a, b, SOFT, 0.006 * top);
                line(on((1 - part) / 2), on((1 + part) / 2), `rgb(${colour})`, at[`diameter${i}`], "butt");
            }
            element(svg, "circle", {r: 0.02 * top, fill: "#fff", stroke: INK, "stroke-width": 0.006 * top});
        }
        function step(now) {
            if (!playing) return;
            slider.value = (now - began) / 1e3 / (times[1] - times[0]);
            playing = Number(slider.value) < times.length - 1;
            draw();
            requestAnimationFrame(step);
        }
        button.addEventListener("click", () => {
            playing = !playing;
            if (Number(slider.value) >= times.length - 1) slider.value = 0;
            began = performance.now() - 1e3 * times[slider.value];
            draw();
            requestAnimationFrame(step);
        });
        slider.addEventListener("input", (event) => {
            event.stopPropagation(); // it is not a parameter
            playing = false;
            draw();
        });
        return (made, found) => {
            [self, rows] = [made, found];
            draw();
        };
    }

    // Charts of the rows that a module computes over a grid, one after the other where it has a state. Columns are those of
    // its rows and the arrays of its points; the curves of the initial values are drawn dashed.
    function table(name, module, {range, every, x, charts: wanted, says, picture}) {
        const steps = grid(...range), play = picture ? player(document.getElementById(name), module, steps.filter((_, k) => k % every === 0)) : null;
        const computed = (values) => {
            const self = made(module, values), rows = [];
            module.init?.(self);
            steps.forEach((at, k) => {
                const row = module.row(self, at);
                if (k % every === 0) rows.push(Object.assign(row, {x: at}));
            });
            const columns = Object.fromEntries(Object.keys(rows[0]).map((key) => [key, rows.map((row) => row[key])]));
            return {self, rows, columns: Object.assign(columns, module.points?.(self).points), found: module.summary?.(self) ?? {}};
        };
        let initial;
        start(name, (values, first, parent) => {
            initial ??= computed(first).columns;
            const {self, rows, columns, found} = computed(values);
            for (const {title, label, factor = 1, limit = Infinity, curves, bands = [], low, high, across = x} of wanted) {
                const at = (of, key = across.column ?? "x") => of[key].map((u) => u * (across.factor ?? 1));
                const y = (of, key) => of[key].map((v) => (Math.abs(v * factor) < limit ? v * factor : NaN));
                const all = [initial, columns].flatMap((of) => curves.flatMap((one) => at(of, one.x))).filter(Number.isFinite);
                const axis = {low: across.low ?? Math.min(...all), high: across.high ?? Math.max(...all), label: across.label};
                chart(parent, title, axis, {label, low, high}, [
                    ...curves.filter((one) => !one.fixed).map((one) => ({x: at(initial, one.x), y: y(initial, one.column), colour: SOFT, dashed: true, dots: one.dots})),
                    ...curves.map((one, k) => ({...one, x: at(columns, one.x), y: y(columns, one.column), colour: one.fixed ? SOFT : COLOURS[k % 3], dashed: one.fixed})),
                ], bands.map(([under, over]) => ({x: at(columns), low: y(columns, under), high: y(columns, over)})));
            }
            play?.(self, rows);
            const [, words] = says.find(([key]) => !key || found[key] > 0);
            return words.replace(/{(\w+)}/g, (_, key) => show(Number(found[key].toPrecision(3))));
        });
    }

    return {force, attainable, table};
})();
