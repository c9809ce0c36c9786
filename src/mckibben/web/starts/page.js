// Saving of charts in the browser, and what the pages do without the server.
document.documentElement.lang = "en";

function chartRows(option) {
  // Rows of a table: name of the curve, x, y and, where points have one, a third number.
  const rows = [], ends = {};
  for (const series of option.series) {
    const low = series.stack && !series.name.endsWith(" from") ? ends[series.stack] : null; // areas are stacked
    if (series.stack) ends[series.stack] = series.data;
    const name = low ? `${series.name} to` : series.name;
    series.data.forEach((pair, i) => rows.push([name, pair[0], low ? pair[1] + low[i][1] : pair[1], ...pair.slice(2)]));
  }
  return rows;
}

async function saveChart(id, kind, name) {
  const chart = getElement(id).chart, option = chart.getOption();
  const third = option.visualMap?.length ? [option.visualMap[0].text[0]] : [];
  let content, type;
  if (kind === "csv") {
    const quoted = (value) => (typeof value === "string" ? `"${value.replaceAll('"', '""')}"` : value ?? "");
    const rows = [["curve", option.xAxis[0].name, option.yAxis[0].name, ...third], ...chartRows(option)];
    content = rows.map((row) => row.map(quoted).join(",")).join("\n") + "\n";
    type = "text/csv";
  } else if (kind === "svg") {
    const { echarts } = await import("nicegui-echart");
    const size = { width: chart.getWidth(), height: chart.getHeight() };
    const drawn = echarts.init(null, null, { renderer: "svg", ssr: true, ...size });
    drawn.setOption({ ...option, toolbox: [] });
    content = drawn.renderToSVGString();
    drawn.dispose();
    type = "image/svg+xml";
  }
  const link = document.createElement("a");
  const png = { type: "png", pixelRatio: 2, backgroundColor: "#fff", excludeComponents: ["toolbox"] };
  link.href = content ? URL.createObjectURL(new Blob([content], { type })) : chart.getDataURL(png);
  link.download = `${name}.${kind}`;
  link.click();
  return content ?? link.href;
}

if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
  const still = () => document.querySelectorAll("svg").forEach((svg) => svg.pauseAnimations());
  new MutationObserver(still).observe(document.documentElement, { childList: true, subtree: true });
}
