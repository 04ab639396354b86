"use strict";
// Draws the curves and the 3D view from the numbers in the page. Loads nothing from outside the page.

const data = JSON.parse(document.getElementById("data").textContent);
const family = getComputedStyle(document.body).fontFamily;
const config = { responsive: true, displayModeBar: false };
const charts = [];
const NARROW = innerWidth < 640;

function axis(layout, style) {
  const { title, ...rest } = layout;
  return { gridcolor: "#e8ebef", linecolor: "#9aa4af", tickcolor: "#9aa4af", ticks: "outside", ticklen: 4, showline: true,
    zeroline: false, automargin: true, title: { text: title, font: { size: 13 }, standoff: 8 }, ...style, ...rest };
}

function draw(id, figure) {
  const box = document.getElementById(id);
  const { xaxis, yaxis, legend, ...layout } = figure.layout;
  box.style.height = figure.height + "px";
  charts.push(box);
  return Plotly.newPlot(box, figure.traces, {
    font: { family, size: 12, color: "#1b1f24" }, margin: { l: 56, r: 12, t: 8, b: 46 }, hovermode: "x unified",
    paper_bgcolor: "white", plot_bgcolor: "white", hoverlabel: { font: { size: 12 } },
    xaxis: axis(xaxis), yaxis: axis(yaxis), ...layout,
    legend: { font: { size: 12 }, ...legend, ...(NARROW && legend?.traceorder ? { orientation: "h", x: 0, y: -0.2 } : {}) },
  }, config);
}

// ---- 3D ----------------------------------------------------------------------------------------------

function integers(text, size = 2) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let k = 0; k < raw.length; k++) bytes[k] = raw.charCodeAt(k);
  const view = new DataView(bytes.buffer), numbers = new Float64Array(raw.length / size);
  for (let k = 0; k < numbers.length; k++)
    numbers[k] = size === 4 ? view.getUint32(4 * k, true) : view.getUint16(2 * k, true);
  return numbers;
}

function every(numbers, first, step) {
  const part = new Float64Array(Math.floor((numbers.length - first + step - 1) / step));
  for (let k = 0; k < part.length; k++) part[k] = numbers[first + k * step];
  return part;
}

class Solid {
  constructor(solid) {
    this.solid = solid;
    this.kinds = ["target", "particle", "target section", "particle section"];
    this.box = document.getElementById("solid");
    this.slider = document.getElementById("time");
    this.chooser = document.getElementById("field");
    this.whole = document.getElementById("whole");
    this.step = solid.times.length - 1;
    this.timer = 0;
    this.busy = false;
    for (const field of solid.fields)
      this.chooser.add(new Option(field.unit ? `${field.label} (${field.unit})` : field.label, field.name));
    this.slider.max = this.slider.value = this.step;
    this.slider.addEventListener("input", () => { this.stop(); this.show(+this.slider.value); });
    this.chooser.addEventListener("change", () => this.show(this.step));
    this.whole.addEventListener("change", () => this.turn());
    document.getElementById("play").addEventListener("click", () => (this.timer ? this.stop() : this.play()));
  }

  mesh(kind, step, field) {
    const [low, high] = this.transposed(), part = this.solid.frames[step][kind];
    const points = integers(part.points), corners = integers(this.solid.triangles[part.triangles], 4);
    const [x, y, z] = [0, 1, 2].map((k) => {
      const span = high[k] - low[k];
      return every(points, k, 3).map((n) => low[k] - span + (n / 65535) * 3 * span);
    });
    const intensity = integers(part.values[field.name]).map((n) => field.least + (n / 65535) * field.span);
    const [i, j, k] = [0, 1, 2].map((n) => every(corners, n, 3));
    return { x, y, z, i, j, k, intensity };
  }

  transposed() {
    return [0, 1].map((end) => this.solid.box.map((ends) => ends[end]));
  }

  lines(step) {
    const x = [], y = [], z = [];
    for (const line of this.solid.frames[step].lines) {
      for (let k = 0; k < line.length; k += 2) { x.push(line[k]); y.push(this.solid.plane - 0.05); z.push(line[k + 1]); }
      x.push(null); y.push(null); z.push(null);
    }
    return { x, y, z };
  }

  traces(step) {
    const field = this.solid.fields.find((field) => field.name === this.chooser.value);
    const open = !this.whole.checked;
    const meshes = this.kinds.map((kind, number) => ({
      type: "mesh3d", name: kind, ...this.mesh(kind, step, field), colorscale: field.colours, cmin: field.low, cmax: field.high,
      visible: open || number < 2, showscale: number === 0, flatshading: false,
      hovertemplate: `%{intensity:.4g} ${field.unit}<br>x %{x:.1f}, y %{y:.1f}, z %{z:.1f} µm<extra>${kind}</extra>`,
      lighting: number < 2 ? { ambient: 0.5, diffuse: 0.45, specular: 0.05, roughness: 0.9, fresnel: 0.05 } : { ambient: 1, diffuse: 0, specular: 0 },
      lightposition: { x: -3e3, y: -6e3, z: 1e4 },
      colorbar: { title: { text: field.unit ? `${field.label} (${field.unit})` : field.label, side: "right" }, thickness: 14, len: 0.8, x: 1.0, outlinewidth: 0 },
    }));
    const outline = { type: "scatter3d", mode: "lines", ...this.lines(step), visible: open, hoverinfo: "skip", line: { color: "#111", width: 3 }, showlegend: false };
    return [...meshes, outline];
  }

  scene(camera) {
    const [x, y, [bottom, top]] = this.solid.box, plane = this.solid.plane, whole = this.whole.checked;
    const z = [whole ? Math.max(bottom, this.solid.lowest) : bottom, top]; // below it a whole target shows nothing
    const depth = whole ? y : [plane - 0.1, y[1]];
    const size = x[1] - x[0];
    const style = { showbackground: false, showspikes: false, showgrid: false, zeroline: false, ticks: "outside", ticklen: 12, nticks: 5, tickfont: { size: 11 }, color: "#5b6470" };
    return {
      xaxis: { ...style, range: x, title: { text: "x (µm)" } }, yaxis: { ...style, range: depth, title: { text: "y (µm)" } },
      zaxis: { ...style, range: z, title: { text: "z (µm)" } }, dragmode: "orbit", camera,
      aspectmode: "manual", aspectratio: { x: 2, y: (2 * (depth[1] - depth[0])) / size, z: (2 * (z[1] - z[0])) / size },
    };
  }

  camera(whole) {
    const [x, , z] = this.solid.box, high = (2 * (z[1] - z[0])) / (x[1] - x[0]);
    const far = (NARROW ? 1.5 : 1) * (0.8 + 0.2 * high); // so that the labels below are inside
    return { eye: { x: -0.9 * far, y: (whole ? -2.3 : -2.2) * far, z: 1.0 * far }, center: { x: 0, y: 0, z: whole ? -0.4 : -0.38 }, up: { x: 0, y: 0, z: 1 } };
  }

  async start() {
    const layout = { scene: this.scene(this.camera(false)), margin: { l: 0, r: 0, t: 0, b: 0 }, font: { family, size: 12, color: "#1b1f24" }, uirevision: "keep", paper_bgcolor: "white" };
    await Plotly.newPlot(this.box, this.traces(this.step), layout, { responsive: true, displaylogo: false, modeBarButtons: [["toImage", "resetCameraDefault3d"]] });
    this.label();
    this.box.on("plotly_relayout", () => this.forPrint()); // the camera
    this.forPrint();
  }

  async show(step) {
    this.step = step;
    this.label();
    if (this.busy) return; // the newest step is drawn when the one under way is done
    this.busy = true;
    let drawn = -1, name = "";
    while (drawn !== this.step || name !== this.chooser.value) {
      [drawn, name] = [this.step, this.chooser.value];
      await Plotly.react(this.box, this.traces(drawn), this.box.layout, this.box._context);
    }
    this.busy = false;
    this.forPrint();
  }

  async turn() {
    this.stop();
    this.box.layout.scene = this.scene(this.camera(this.whole.checked));
    await Plotly.react(this.box, this.traces(this.step), { ...this.box.layout, uirevision: this.whole.checked ? "whole" : "open" });
    this.forPrint();
  }

  label() {
    this.slider.value = this.step;
    document.getElementById("now").textContent = this.solid.times[this.step].toFixed(1) + " ns";
  }

  play() {
    document.getElementById("play").textContent = "Pause";
    if (this.step === this.solid.times.length - 1) this.step = -1;
    this.timer = setInterval(() => {
      if (this.busy) return;
      if (this.step + 1 >= this.solid.times.length) return this.stop();
      this.show(this.step + 1);
    }, 160);
  }

  stop() {
    clearInterval(this.timer);
    this.timer = 0;
    this.forPrint();
    document.getElementById("play").textContent = "Play";
  }

  // browsers do not print the WebGL view: its picture is printed instead, made when the view no longer moves
  forPrint() {
    clearTimeout(this.printing);
    this.printing = setTimeout(async () => {
      if (this.timer || this.busy) return;
      const picture = document.getElementById("solid-picture");
      picture.src = await Plotly.toImage(this.box, { format: "png", width: 1000, height: 560, scale: 1.5 });
    }, 700);
  }
}

function webgl() {
  try { return !!document.createElement("canvas").getContext("webgl"); } catch { return false; }
}

// ---- the page ------------------------------------------------------------------------------------------

async function start() {
  for (const [id, figure] of Object.entries(data.charts)) await draw(id, figure);
  if (data.solid && webgl()) {
    window.solid = new Solid(data.solid);
    await window.solid.start();
  } else if (data.solid) {
    document.getElementById("solid").outerHTML = '<p class="note">This browser has no WebGL: the 3D view is left out.</p>';
    document.getElementById("solid-controls").remove();
  }
  document.body.dataset.ready = "yes";
}

for (const button of document.querySelectorAll("button.copy"))
  button.addEventListener("click", async () => {
    const text = document.getElementById(button.dataset.of);
    try {
      await navigator.clipboard.writeText(text.textContent);
    } catch { // some browsers do not permit the clipboard to pages from a file
      const range = document.createRange();
      range.selectNodeContents(text);
      getSelection().removeAllRanges();
      getSelection().addRange(range);
      document.execCommand("copy");
    }
    button.textContent = "Copied";
    setTimeout(() => (button.textContent = "Copy"), 1500);
  });

// A sheet of A4 within its margins, and how many charts stand beside each other on it, as in page.css.
const PAPER = 680, BESIDE = { two: 2, three: 3, four: 2 };
addEventListener("beforeprint", () => {
  for (const folded of document.querySelectorAll("details")) folded.open = true;
  for (const box of charts) {
    const beside = BESIDE[box.parentNode.parentNode.className] ?? 1;
    Plotly.relayout(box, { autosize: false, width: Math.floor((PAPER - 18 * (beside - 1)) / beside) });
  }
});
addEventListener("afterprint", () => charts.forEach((box) => Plotly.relayout(box, { autosize: true, width: null })));
start();
