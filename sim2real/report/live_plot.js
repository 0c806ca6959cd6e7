// Draws the panels of every figure that has some with uPlot, and zooms those of one recording together.
(() => {
  "use strict";
  const decoded = (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return Array.from(new Float32Array(bytes.buffer), (x) => (Number.isNaN(x) ? null : x));
  };
  const colour = (name) =>
    getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const shown = (x) => (x == null ? "–" : Number(x.toPrecision(4)).toString());

  // The shaded times and the band lie below the curves.
  const background = (panel) => (plot) => {
    const { ctx, bbox } = plot;
    const fill = (ink, alpha, x, y, width, height) => {
      ctx.globalAlpha = alpha;
      ctx.fillStyle = colour(ink);
      ctx.fillRect(x, y, width, height);
    };
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    for (const [start, stop] of panel.shaded) {
      const left = plot.valToPos(start, "x", true);
      fill("rule", 0.6, left, bbox.top, plot.valToPos(stop, "x", true) - left, bbox.height);
    }
    if (panel.band !== null) {
      const top = plot.valToPos(panel.band, "y", true);
      const bottom = plot.valToPos(-panel.band, "y", true);
      fill("accent", 0.16, bbox.left, top, bbox.width, bottom - top);
    }
    ctx.restore();
  };

  const axis = (more) => ({
    stroke: colour("muted"),
    grid: { stroke: colour("rule"), width: 1 },
    ticks: { show: false },
    font: "12px system-ui, sans-serif",
    ...more,
  });

  const series = (curve) => ({
    label: curve.label,
    stroke: colour(curve.ink),
    width: curve.ink === "ink" ? 1.6 : 1.2,
    points: curve.ink === "ink" ? { size: 4 } : { show: false },  // where there is room for them
    paths: curve.steps ? uPlot.paths.stepped({ align: 1 }) : undefined,
    value: (_, x) => shown(x),
  });

  // Two fingers move and stretch the time axis; one scrolls the page.
  const pinched = (plot) => {
    let start = null;
    const fingers = (event) => {
      const left = plot.over.getBoundingClientRect().left;
      return Array.from(event.touches, (touch) => touch.clientX - left).sort((a, b) => a - b);
    };
    plot.over.addEventListener("touchstart", (event) => {
      const places = fingers(event);
      start = places.length === 2 ? places.map((place) => plot.posToVal(place, "x")) : null;
    }, { passive: true });
    plot.over.addEventListener("touchmove", (event) => {
      if (start === null || event.touches.length !== 2) return;
      event.preventDefault();
      const [a, b] = fingers(event);
      if (b - a < 10) return;
      const perPixel = (start[1] - start[0]) / (b - a);
      const min = start[0] - a * perPixel;
      plot.setScale("x", { min, max: min + plot.over.clientWidth * perPixel });
    }, { passive: false });
  };

  const draw = (figure, number) => {
    const panels = JSON.parse(figure.querySelector("script.panels").textContent);
    const place = figure.querySelector(".live");
    let plots = [];
    let busy = false;
    const together = (plot, key) => {
      if (key !== "x" || busy || !plots.includes(plot)) return;
      busy = true;
      const { min, max } = plot.scales.x;
      const recording = panels[plots.indexOf(plot)].recording;
      plots.forEach((other, k) => {
        if (other !== plot && panels[k].recording === recording) other.setScale("x", { min, max });
      });
      busy = false;
    };
    const build = () => {
      for (const plot of plots) plot.destroy();
      plots = [];
      place.textContent = "";
      figure.classList.add("interactive");
      plots = panels.map((panel) => new uPlot({
        title: panel.title,
        width: place.clientWidth,
        height: 190,
        scales: { x: { time: false }, y: panel.log ? { distr: 3 } : {} },
        cursor: { sync: { key: `${number}-${panel.recording}` }, drag: { x: true, y: false }, y: false },
        axes: [axis({ size: 28 }), axis({ size: 52 })],
        series: [{ label: "time, s", value: (_, x) => shown(x) }, ...panel.curves.map(series)],
        hooks: { drawClear: [background(panel)], setScale: [together], ready: [pinched] },
      }, [decoded(panel.t), ...panel.curves.map((curve) => decoded(curve.y))], place));
    };
    build();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build);
    let width = place.clientWidth;
    addEventListener("resize", () => {
      if (place.clientWidth === 0 || place.clientWidth === width) return;
      width = place.clientWidth;
      for (const plot of plots) plot.setSize({ width, height: plot.height });
    });
  };

  document.querySelectorAll("figure:has(> script.panels)").forEach(draw);
})();
