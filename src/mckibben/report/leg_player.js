// Player of runs of a leg: draws frames of inline data on canvases, interpolated between frames.
const legPlayer = (function () {
    "use strict";
    const INK = "#1c2024", SOFT = "#59626b", LINE = "#d9dfe5", BONE = "#aab2ba", AXLE = "#4a525a", TRUNK = "#215c8f", FORCE = "#00684a";
    const STYLE = `
.leg-player { font-family: system-ui, sans-serif; }
.leg-player .stages { display: flex; flex-wrap: wrap; gap: 1rem; }
.leg-player canvas { flex: 1 1 16rem; min-width: 0; max-width: 34rem; width: 100%; height: 30rem; border: 1px solid ${LINE}; border-radius: 8px; }
.leg-player .controls { display: flex; gap: .8rem; align-items: center; margin: .6rem 0; font-size: .88rem; max-width: 69rem; }
.leg-player .controls > input { flex: 1; }
.leg-player input { accent-color: #00568a; }
.leg-player button, .leg-player select { font: inherit; padding: .3rem .8rem; border: 1px solid ${SOFT}; border-radius: 6px; background: #fff; color: ${INK}; }
.leg-player button { min-width: 5rem; }
.leg-player :focus-visible { outline: 2px solid #00568a; outline-offset: 2px; }`;
    const WIDER = 2, ARROW = 0.4; // of the muscles; length of the largest force in m

    function frame(run, time, scale) {
        const times = run.times, last = times.length - 1;
        let low = 0, high = last;
        while (high - low > 1) {
            const middle = (low + high) >> 1;
            if (times[middle] <= time) low = middle;
            else high = middle;
        }
        const part = Math.min(Math.max((time - times[low]) / (times[high] - times[low] || 1), 0), 1);
        return run.rows[low].map((one, k) => (one + part * (run.rows[high][k] - one)) / scale);
    }

    function draw(canvas, run, time, all, turn) {
        const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
        if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
        if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
        const pen = canvas.getContext("2d"), below = 34, above = 48;
        const size = Math.min((height - above - below) / all.top, width / (all.right - all.left));
        const px = (x) => width / 2 + (x - (all.left + all.right) / 2) * size, pz = (z) => height - below - z * size;
        pen.setTransform(ratio, 0, 0, ratio, 0, 0);
        pen.clearRect(0, 0, width, height);
        const row = frame(run, time, all.scale);
        let next = 0;
        const take = () => row[next++], space = () => [take(), take(), take()];
        const seen = ([x, y, z]) => [x * Math.cos(turn) - y * Math.sin(turn), z]; // from the right, or turned
        const put = (at) => { const [x, z] = seen(at); return [px(x), pz(z)]; }, point = () => put(space());

        function line(from, to, thick, colour, cap = "round") {
            pen.strokeStyle = colour; pen.lineWidth = thick; pen.lineCap = cap;
            pen.beginPath(); pen.moveTo(...from); pen.lineTo(...to); pen.stroke();
        }
        function disc(at, radius, colour) {
            pen.fillStyle = colour; pen.beginPath(); pen.arc(...at, radius, 0, 2 * Math.PI); pen.fill();
        }
        function muscle(ends, length, diameter, filling) {
            const [from, to] = ends.map(put), far = Math.hypot(...ends[0].map((one, k) => one - ends[1][k]));
            const shorter = Math.hypot(to[0] - from[0], to[1] - from[1]) / (far * size || 1);
            const half = shorter * length * size / 2, wide = WIDER * diameter * size / 2;
            const [low, high] = all.colours, rgb = low.map((one, k) => Math.round(one + Math.min(filling, 1) * (high[k] - one)));
            pen.save();
            pen.translate((from[0] + to[0]) / 2, (from[1] + to[1]) / 2);
            pen.rotate(Math.atan2(to[1] - from[1], to[0] - from[0]));
            const neck = 0.006 * size * WIDER, taper = Math.min(2.2 * wide, half / 2);
            pen.beginPath();
            pen.moveTo(-half, -neck / 2);
            pen.bezierCurveTo(-half + taper / 2, -neck / 2, -half + taper / 2, -wide, -half + taper, -wide);
            pen.lineTo(half - taper, -wide);
            pen.bezierCurveTo(half - taper / 2, -wide, half - taper / 2, -neck / 2, half, -neck / 2);
            pen.lineTo(half, neck / 2);
            pen.bezierCurveTo(half - taper / 2, neck / 2, half - taper / 2, wide, half - taper, wide);
            pen.lineTo(-half + taper, wide);
            pen.bezierCurveTo(-half + taper / 2, wide, -half + taper / 2, neck / 2, -half, neck / 2);
            pen.closePath();
            pen.fillStyle = `rgb(${rgb})`; pen.fill();
            pen.lineWidth = 1; pen.strokeStyle = "rgba(28,32,36,.55)"; pen.stroke();
            pen.restore();
        }
        function arrow(at, force) {
            const to = [at[0] + force[0] * ARROW * size, at[1] - force[1] * ARROW * size];
            const far = Math.hypot(to[0] - at[0], to[1] - at[1]);
            if (far < 4) return;
            const [ux, uy] = [(to[0] - at[0]) / far, (to[1] - at[1]) / far], head = Math.min(12, far);
            const neck = [to[0] - head * ux, to[1] - head * uy];
            line(at, neck, 3.5, FORCE, "butt");
            pen.fillStyle = FORCE; pen.beginPath(); pen.moveTo(...to);
            pen.lineTo(neck[0] - 6 * uy, neck[1] + 6 * ux); pen.lineTo(neck[0] + 6 * uy, neck[1] - 6 * ux); pen.fill();
        }

        pen.fillStyle = "#f4f6f8"; pen.fillRect(0, pz(0), width, height);
        line([0, pz(0)], [width, pz(0)], 1.5, SOFT, "butt");
        const points = Array.from({length: run.points}, point), bones = Math.max(4, 0.02 * size);
        line(points[0], points[1], bones, BONE);
        points.slice(2).forEach((at, k) => line(points[k + 1], at, bones, BONE));
        const [top, hip] = points, up = Math.atan2(top[1] - hip[1], top[0] - hip[0]);
        pen.save(); pen.translate(...top); pen.rotate(up + Math.PI / 2);
        pen.fillStyle = TRUNK; pen.fillRect(-0.07 * size, -0.06 * size, 0.14 * size, 0.06 * size);
        pen.restore();
        for (const at of points.slice(1, -1)) disc(at, 0.028 * size, AXLE);
        disc(points.at(-1), Math.max(run.foot * size, 2), INK);
        for (const one of run.muscles) {
            const parts = Array.from({length: one.parts}, () => [space(), space()]);
            for (const part of parts) line(...part.map(put), 1.6, AXLE, "butt");
            muscle(parts[one.place], take(), take(), take());
        }
        const force = space(), foot = points.at(-1);
        arrow([foot[0], Math.min(foot[1] + run.foot * size, pz(0))], seen(force));

        pen.fillStyle = INK; pen.textAlign = "left"; pen.font = "600 15px system-ui, sans-serif";
        pen.fillText(run.title, 12, 22);
        pen.fillStyle = SOFT; pen.font = "13px system-ui, sans-serif";
        const weights = run.weights * Math.hypot(...force), shown = Math.min(time, run.times.at(-1)) / all.scale * 1e3;
        pen.fillText(`${shown.toFixed(0)} ms`, 12, height - 12);
        pen.textAlign = "right";
        pen.fillText(`force ${weights.toFixed(1)} body weights`, width - 12, height - 12);
    }

    return function (name, all) {
        const root = document.getElementById(name), canvases = [...root.querySelectorAll("canvas")];
        const button = root.querySelector("button"), slider = root.querySelector("input"), speed = root.querySelector("select");
        const turn = root.querySelector(".turn");
        const end = Math.max(...all.runs.map((run) => run.times.at(-1)));
        root.appendChild(document.createElement("style")).textContent = STYLE;
        let time = 0, playing = false, before = 0;
        function show() {
            slider.value = 1000 * time / end;
            slider.setAttribute("aria-valuetext", `${(time / all.scale * 1e3).toFixed(0)} ms`);
            button.textContent = playing ? "Pause" : "Play";
            const angle = turn ? turn.value * Math.PI / 180 : 0;
            canvases.forEach((canvas, k) => draw(canvas, all.runs[k], time, all, angle));
        }
        function step(now) {
            if (!playing) return;
            time = Math.min(time + (now - before) / 1e3 * all.scale * speed.value, end);
            before = now;
            if (time >= end) playing = false;
            show();
            requestAnimationFrame(step);
        }
        button.addEventListener("click", () => {
            playing = !playing;
            if (playing && time >= end) time = 0;
            before = performance.now();
            show();
            requestAnimationFrame(step);
        });
        slider.addEventListener("input", () => {
            time = slider.value / 1000 * end;
            playing = false;
            show();
        });
        if (turn) turn.addEventListener("input", show);
        new ResizeObserver(show).observe(root);
        show();
    };
})();
