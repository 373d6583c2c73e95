// The panel beside the player: values and curves at the player's time, cameras, the singularity meter.
// The player offers no interface for this. What is used of it: the slider's aria-valuenow (its time) and handler
// (to go to a time), and window.__viserMutable (the camera). Without them the panel stays at the first moment.
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("holdfast-data").textContent);
  const panel = document.getElementById("holdfast");
  const last = data.times.length - 1, end = data.times[last];
  const WIDTH = 276, HEIGHT = 62, LEFT = 34, TOP = 5, BOTTOM = 4;

  function add(parent, tag, attributes = {}, text = "") {
    const svg = parent.namespaceURI.endsWith("svg") || tag === "svg";
    const node = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
    node.textContent = text;
    return parent.appendChild(node);
  }

  // a number in few digits; what is nothing beside the largest one is 0
  function short(x, largest) {
    if (x === null) return "–";
    const size = Math.abs(x);
    if (size <= 1e-4 * largest) return "0";
    if (size >= 1e5 || size < 1e-3) return x.toExponential(1);
    return size >= 100 ? x.toFixed(0) : size >= 10 ? x.toFixed(1) : size >= 1 ? x.toFixed(2) : x.toPrecision(2);
  }

  // round ends of an axis for values between low and high; it begins at 0 if the values come halfway down to it
  function ends(low, high) {
    if (low === 0 && high === 0) return [0, 1];
    if (low > 0 && low < 0.5 * high) low = 0;
    if (high < 0 && high > 0.5 * low) high = 0;
    const span = Math.max(high - low, 0.1 * Math.max(Math.abs(low), Math.abs(high)));
    const power = 10 ** Math.floor(Math.log10(span / 3)), more = (span - (high - low)) / 2;
    const step = power * [1, 2, 5, 10].find((times) => times * power >= span / 5);
    return [Math.floor((low - more) / step + 1e-6) * step, Math.ceil((high + more) / step - 1e-6) * step];
  }

  // the last moment that is not later than t
  function momentAt(t) {
    let low = 0, high = last;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (data.times[middle] <= t + 1e-6) low = middle; else high = middle - 1;
    }
    return low;
  }

  const slider = () => document.querySelector("#root [role=slider]");
  const playerTime = () => Number(slider()?.getAttribute("aria-valuenow") ?? 0);

  // The time field rounds to 0.1 s and the bar to pixels; the slider's own handler takes any time.
  function goTo(t) {
    const node = slider();
    let fiber = node?.[Object.keys(node).find((key) => key.startsWith("__reactFiber$"))];
    while (fiber && !(fiber.memoizedProps?.onChange && fiber.memoizedProps.max !== undefined)) fiber = fiber.return;
    fiber?.memoizedProps.onChange(t);
  }

  // Cameras are for pictures at least as wide as high; from a narrow one the eye goes further away.
  let chosen = data.cameras[0], looking = false;
  const picture = () => document.querySelector("#root canvas");
  const narrowness = () => Math.max(1, (picture()?.clientHeight ?? 1) / (picture()?.clientWidth || 1));
  for (const moved of ["pointerdown", "wheel"])
    document.getElementById("root").addEventListener(moved, (event) => {
      if (event.target === picture()) chosen = null;
    }, { capture: true, passive: true });
  window.addEventListener("resize", () => setTimeout(() => chosen && lookFrom(chosen), 100));

  // a point in the player's own axes, which have y up; null before the player is ready
  function turned([a, b, c]) {
    const root = window.__viserMutable?.nodePoseData?.[""]?.wxyz;
    if (!root || !window.__viserMutable.cameraControl) return null;
    const [w, x, y, z] = root;
    return [
      (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
      2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c,
      2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c,
    ];
  }

  function lookFrom(camera) {
    chosen = camera;
    const eye = turned(camera.target.map((at, i) => at + narrowness() * (camera.position[i] - at)));
    if (eye) window.__viserMutable.cameraControl.setLookAt(...eye, ...turned(camera.target), true);
  }

  // Once the player looks from its first camera, go as far away as the picture asks for.
  function lookAtFirst() {
    const eye = turned(chosen.position), now = window.__viserMutable?.camera?.position?.toArray();
    if (!eye || !now || Math.hypot(...eye.map((x, i) => x - now[i])) > 1e-3 * Math.hypot(...eye)) return false;
    lookFrom(chosen);
    return true;
  }

  function plot(of) {
    const figure = add(panel, "figure");
    add(figure, "figcaption", {}, of.title);
    const row = add(figure, "div", { class: "values" });
    const values = of.curves.map((curve) => {
      const style = `--colour:${curve.colour};--line:${curve.dashed ? "dashed" : "solid"}`;
      const entry = add(row, "span", { style });
      add(entry, "bdi", {}, curve.label);  // whatever the direction of its letters, the number follows
      return entry.appendChild(document.createTextNode(""));
    });
    const all = [...of.curves.flatMap((curve) => curve.values), ...of.lines].filter((v) => v !== null);
    const largest = of.log ? 0 : all.reduce((a, b) => Math.max(a, Math.abs(b)), 0);
    let cursor = null;
    if (last > 0) {
      const scale = of.log ? Math.log10 : (v) => v;
      const within = of.range ? [...of.range, ...of.lines] : all.map(scale);  // a spike goes beyond the axis
      let low = within.reduce((a, b) => Math.min(a, b), Infinity), high = within.reduce((a, b) => Math.max(a, b), -Infinity);
      if (of.log) { low = Math.floor(low); high = Math.max(Math.ceil(high), low + 1); }
      else [low, high] = ends(low, high);
      const X = (t) => LEFT + (WIDTH - LEFT - 2) * t / end;
      const Y = (v) => TOP + (HEIGHT - TOP - BOTTOM) * (high - Math.min(Math.max(scale(v), low), high)) / (high - low);
      const svg = add(figure, "svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" });
      add(svg, "title", {}, of.title);
      for (const [v, y] of [[high, TOP], [low, HEIGHT - BOTTOM]]) {
        add(svg, "line", { x1: LEFT, x2: WIDTH, y1: y, y2: y, stroke: "#ddd" });
        add(svg, "text", { x: LEFT - 4, y: y + 3, "text-anchor": "end" }, short(of.log ? 10 ** v : v, largest));
      }
      for (const v of of.lines)
        add(svg, "line", { x1: LEFT, x2: WIDTH, y1: Y(v), y2: Y(v), stroke: "#d55e00", "stroke-dasharray": "2 2" });
      of.curves.forEach((curve, i) => {  // each narrower than the one below, which thus shows where both are equal
        const points = curve.values.map((v, k) => v === null ? "" : `${X(data.times[k]).toFixed(1)},${Y(v).toFixed(1)}`);
        const dashes = curve.dashed ? "4 3" : "none";
        add(svg, "polyline", { points: points.join(" "), fill: "none", stroke: curve.colour, "stroke-width": 1.4 + 1.8 * (of.curves.length - 1 - i) / Math.max(of.curves.length - 1, 1),
          "stroke-dasharray": dashes, "stroke-dashoffset": 3.5 * i });
      });
      if (of.range) for (const [curve, pick, sign] of of.curves.flatMap((c) => [[c, Math.max, "▲"], [c, Math.min, "▼"]])) {
        const peak = curve.values.filter((v) => v !== null).reduce((a, b) => pick(a, b)), at = curve.values.indexOf(peak);
        if (peak >= low && peak <= high) continue;
        const x = X(data.times[at]), late = x > WIDTH / 2, y = peak > high ? TOP + 8 : HEIGHT - BOTTOM - 2;
        add(svg, "text", { x: x + (late ? -3 : 3), y, "text-anchor": late ? "end" : "start" }, `${sign} ${short(peak, largest)}`);
      }
      cursor = add(svg, "line", { y1: 0, y2: HEIGHT, stroke: "#000", "stroke-width": 0.8, class: "cursor" });
      cursor.moveTo = (t) => { cursor.setAttribute("x1", X(t)); cursor.setAttribute("x2", X(t)); };
      const follow = (event) => {
        if (!(event.buttons & 1)) return;
        const frame = svg.getBoundingClientRect();
        const x = (event.clientX - frame.left) / frame.width * WIDTH;
        goTo(Math.min(Math.max((x - LEFT) / (WIDTH - LEFT - 2), 0), 1) * end);
      };
      svg.addEventListener("pointerdown", follow);
      svg.addEventListener("pointermove", follow);
    }
    return (k, t) => {
      of.curves.forEach((curve, i) => { values[i].data = ` ${short(curve.values[k], largest)}`; });
      cursor?.moveTo(t);
    };
  }

  // bars of limits in use: full at the limit, red beyond it; a line at what the controller may use
  function bars(of) {
    const figure = add(panel, "figure", { class: "bars" }), high = 120, bottom = 42, foot = 12;
    add(figure, "figcaption", {}, `${of.title}, use of limits [%]`);
    const svg = add(figure, "svg", { viewBox: `0 0 ${WIDTH} ${bottom + foot}`, role: "img" });
    add(svg, "title", {}, "joint torques, and friction of the grasp, as shares of their limits");
    const pitch = Math.min((WIDTH - LEFT) / of.bars.length, 40), Y = (v) => bottom * (1 - Math.min(v, high) / high);
    const shown = of.bars.map((bar, i) => {
      const x = LEFT + pitch * (i + 0.15), width = 0.7 * pitch;
      add(svg, "rect", { x, width, y: Y(100), height: bottom - Y(100), fill: "#eee" });
      if (of.bars.length <= 12)
        add(svg, "text", { x: x + width / 2, y: bottom + foot - 3, "text-anchor": "middle" }, bar.label);
      return add(svg, "rect", { x, width, y: bottom, height: 0, class: "used" });
    });
    for (const v of new Set([100, of.allowed])) {
      const far = LEFT + pitch * of.bars.filter((bar) => v === 100 || bar.label !== "grip").length;
      add(svg, "line", { x1: LEFT, x2: far, y1: Y(v), y2: Y(v), stroke: "#d55e00", "stroke-dasharray": v === 100 ? "none" : "2 2" });
      add(svg, "text", { x: LEFT - 4, y: Y(v) + 3, "text-anchor": "end" }, String(Math.round(v)));
    }
    return (k) => of.bars.forEach((bar, i) => {
      const v = bar.values[k], y = Y(v);
      for (const [name, value] of [["y", y], ["height", bottom - y], ["fill", v > 100.5 ? "#d55e00" : of.colour]])
        shown[i].setAttribute(name, value);
    });
  }

  function meter(of) {
    const figure = add(panel, "figure");
    const title = add(figure, "figcaption", {}, of.title);
    const needle = add(add(figure, "div", { class: "meter" }), "i");
    const ends = add(figure, "div", { class: "ends" });
    for (const label of of.ends) add(ends, "span", {}, label);
    return (k) => {
      needle.style.left = `${100 * of.values[k]}%`;
      title.textContent = `${of.title}: ${of.names[of.nearest[k]]}`;
    };
  }

  const title = add(panel, "h1");
  add(title, "bdi", {}, data.title);
  const clock = add(title, "output");
  const views = add(panel, "nav");
  for (const camera of data.cameras)
    add(views, "button", { type: "button", title: "look from here" }, camera.name).onclick = () => lookFrom(camera);
  for (const note of data.notes) add(panel, "p", {}, note);
  const shown = [...data.bars.map(bars), ...data.plots.map(plot), ...data.meters.map(meter)];

  let before = null;
  function follow() {
    looking ||= chosen === null || lookAtFirst();
    const t = Math.min(playerTime(), end);
    if (t !== before) {
      before = t;
      const k = momentAt(t);
      clock.textContent = `t = ${(data.start + data.times[k]).toFixed(2)} s`;
      for (const show of shown) show(k, t);
    }
    requestAnimationFrame(follow);
  }
  follow();
  // for those who script the page, and for a page of several: seconds from its beginning (pauses the player), camera
  panel.goTo = goTo;
  panel.seen = () => {
    const camera = window.__viserMutable?.camera?.position?.toArray(), control = window.__viserMutable?.cameraControl;
    return { time: playerTime(), eye: camera, target: control?.getTarget?.(control._target.clone()).toArray(), chosen };
  };
  panel.see = ({ time, eye, target, chosen: before }) => {
    const wanted = Math.min(time, end);
    if (!looking || Math.abs(playerTime() - wanted) > 2e-3) { // not ready, or not there yet
      goTo(wanted);
      return false;
    }
    chosen = before;
    if (eye && target) window.__viserMutable.cameraControl.setLookAt(...eye, ...target, false);
    return true;
  };
})();
