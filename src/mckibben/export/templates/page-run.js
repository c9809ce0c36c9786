// One run of the program, and its outcome by the rules of mckibben's Outcome; for the page, its worker, and Node.

/** The program with the values of sliders [SI] by name; `knows`: whether the controller's model has them, too. */
function adjusted(values, knows) {
    const self = PROGRAM.defaults();
    for (const slider of SETTINGS.sliders) {
        const change = (values[slider.name] ?? slider.nominal) - slider.nominal;
        for (const [member, slopes] of Object.entries(slider.slopes)) {
            if (change === 0 || (!knows && slider.ofModel.includes(member))) continue;
            const at = self.parameters;
            if (Array.isArray(at[member])) at[member] = at[member].map((number, i) => number + slopes[i] * change);
            else at[member] += slopes[0] * change;
        }
    }
    PROGRAM.prepare(self);
    return self;
}

/** Setpoint at the start of each control period. */
function setpoints(self, periods) {
    const angle = new Float64Array(periods), stiffness = new Float64Array(periods);
    for (let i = 0; i < periods; i++) {
        const wanted = PROGRAM.reference(self, i * SETTINGS.period).setpoint;
        angle[i] = wanted.angle;
        stiffness[i] = wanted.stiffness;
    }
    return {angle, stiffness};
}

function startOf(self, wanted) {
    if (!SETTINGS.startsAtReference) return {angle: self.parameters.start_angle, stiffness: self.parameters.start_stiffness};
    const given = Number.isFinite(self.parameters.start_stiffness);
    return {angle: wanted.angle[0], stiffness: given ? wanted.stiffness[0] : NaN};
}

/** Last change of the desired stiffness, as `last_change` in mckibben. */
function lastChange(values) {
    const differs = i => values[i] !== values[i - 1] && !Number.isNaN(values[i]);
    let at = 0;
    for (let i = 1; i < values.length; i++) if (differs(i)) at = i;
    const earlier = Math.max(at - 1, 0), ramp = earlier > 0 && differs(earlier);
    const ends = at > 0 && at < values.length - 1 && !ramp;
    return {at, before: values[earlier], after: values[values.length - 1], ends: Number(ends)};
}

/** A run over all setpoints: columns, metrics, outcome. */
function simulated(self, periods) {
    const wanted = setpoints(self, periods), change = lastChange(wanted.stiffness), columns = {};
    for (const name of SETTINGS.columns) columns[name] = new Float64Array(periods).fill(NaN);
    const start = startOf(self, wanted), exists = PROGRAM.init(self, start);
    let metrics = {};
    if (exists) {
        for (let index = 0; index < periods; index++) {
            const setpoint = {angle: wanted.angle[index], stiffness: wanted.stiffness[index]};
            const seen = PROGRAM.step(self, setpoint, {index, periods}, change).seen;
            for (const name of SETTINGS.columns) columns[name][index] = seen[name];
        }
        ({metrics} = PROGRAM.measure(self, {index: periods, periods}, change));
    } else {
        columns.desired_angle.set(wanted.angle);
        columns.desired_stiffness.set(wanted.stiffness);
    }
    return {columns, metrics, exists, start, outcome: outcomeOf(metrics, wanted, exists)};
}

/** Range, RMS and strokes of a motion; 0 if it is constant within `least`. */
function motion(values, least) {
    let low = Infinity, high = -Infinity, sum = 0, travel = 0;
    values.forEach((value, i) => {
        low = Math.min(low, value);
        high = Math.max(high, value);
        sum += value;
        if (i) travel += Math.abs(value - values[i - 1]);
    });
    const mean = sum / values.length, span = high - low;
    if (!(span > least)) return {span, rms: 0, strokes: 0};
    const deviation = Math.sqrt(values.reduce((total, value) => total + (value - mean) ** 2, 0) / values.length);
    return {span, rms: Math.max(deviation, span / Math.sqrt(8)), strokes: travel / span};
}

/** Name of the outcome, the worst that applies. */
function outcomeOf(metrics, wanted, exists) {
    const rules = SETTINGS.rules, duration = wanted.angle.length * SETTINGS.period;
    const level = wanted.stiffness.reduce((sum, value) => sum + Math.abs(value), 0) / wanted.stiffness.length;
    const angle = motion(wanted.angle, rules.leastAngle), stiffness = motion(wanted.stiffness, rules.leastStiffness * level);
    const strokes = 2 * Math.max(angle.strokes, stiffness.strokes) + 2 + duration;
    const most = {
        travel: rules.stroke * strokes / duration,
        angle: angle.rms > 0 ? rules.followed * angle.rms : rules.left,
        stiffness: rules.followed * (stiffness.rms > 0 ? stiffness.rms : level),
    };
    const worstFirst = [
        ["NO_START", !exists],
        ["DIVERGED", !Number.isFinite(metrics.angle_max)],
        ["SWUNG_OVER", metrics.angle_max > rules.swungOver],
        ["LEFT_REFERENCE", metrics.angle_at_end > Math.max(angle.span, rules.left)],
        ["LIMIT_CYCLE", metrics.oscillation_amplitude > 0],
        ["CHATTER", metrics.command_travel > most.travel],
        ["NOT_FOLLOWED", metrics.angle_rmse > most.angle || metrics.stiffness_rmse > most.stiffness],
        ["LEFT_DOMAIN", metrics.time_outside_domain > 0 || metrics.time_overloaded > 0],
        ["SATURATED", metrics.time_saturated > 0],
        ["COMPLETED", true],
    ];
    return worstFirst.find(([, applies]) => applies)[0];
}

/** What the page shows of a run: that, the attainable stiffness at every n-th period, and the time it took [ms]. */
function shownRun(values, knows) {
    const begin = performance.now(), self = adjusted(values, knows), run = simulated(self, SETTINGS.periods);
    const ms = performance.now() - begin, every = Math.max(1, Math.round(SETTINGS.periods / 400));
    return {...run, band: bandAt(self, run.columns.desired_angle.filter((_, i) => i % every === 0)), every, ms};
}

/** Attainable stiffness at angles. */
function bandAt(self, angles) {
    const low = new Float64Array(angles.length), high = new Float64Array(angles.length);
    angles.forEach((angle, i) => {
        const {band} = PROGRAM.attainable(self, angle);
        low[i] = band.lowest;
        high[i] = band.highest;
    });
    return {low, high};
}
