// Movies: plates as polygons on a canvas, coloured by stress. They play once when they come into view, unless less motion is asked for.
for (const movie of document.querySelectorAll(".movie")) {
  const data = JSON.parse(movie.querySelector("script").textContent);
  const [canvas, button, slider, clock] = ["canvas", "button", "input", "output"].map((name) => movie.querySelector(name));
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const places = new Uint16Array(bytes(data.places).buffer);
  const stress = bytes(data.stress);
  const points = places.length / data.t.length / 2;
  const cells = data.offsets.length - 1;
  const pen = canvas.getContext("2d");
  let began = null; // the clock's time at which the first frame was due, while it plays
  let rounds = 0; // that are left
  let fresh = true; // nothing has played yet: the first play begins with the first frame
  const [left, bottom, gap] = [110, 70, 10]; // room for the axes, and around all

  const draw = (frame) => {
    const scale = (canvas.width - left - gap) / data.width;
    const across = (place) => left + scale * place;
    const up = (place) => canvas.height - bottom - scale * place;
    const x = (i) => across(places[2 * (frame * points + i)]);
    const y = (i) => up(places[2 * (frame * points + i) + 1]);
    const ink = getComputedStyle(movie);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.lineJoin = pen.lineCap = "round";
    pen.lineWidth = canvas.width / 1500;
    pen.strokeStyle = ink.getPropertyValue("--grid");
    pen.fillStyle = ink.getPropertyValue("--quiet");
    pen.font = "22px sans-serif";
    const unit = (k, ticks) => (k === ticks.length - 1 ? " m" : "");
    data.ticks[0].forEach(([place, text], k) => {
      pen.beginPath();
      pen.moveTo(across(place), gap);
      pen.lineTo(across(place), canvas.height - bottom + 12);
      pen.stroke();
      pen.textAlign = "center";
      pen.fillText(text + unit(k, data.ticks[0]), Math.min(across(place), canvas.width - 40), canvas.height - bottom + 45);
    });
    data.ticks[1].forEach(([place, text], k) => {
      pen.beginPath();
      pen.moveTo(left - 12, up(place));
      pen.lineTo(canvas.width - gap, up(place));
      pen.stroke();
      pen.textAlign = "right";
      pen.fillText(text + unit(k, data.ticks[1]), left - 18, up(place) + 9);
    });
    for (let cell = 0; cell < cells; cell++) {
      pen.beginPath();
      for (let k = data.offsets[cell]; k < data.offsets[cell + 1]; k++) pen.lineTo(x(data.nodes[k]), y(data.nodes[k]));
      pen.closePath();
      pen.fillStyle = pen.strokeStyle = data.colours[stress[frame * cells + cell]];
      pen.fill();
      pen.stroke();
    }
    const lines = (pairs, colour, width) => {
      pen.beginPath();
      for (const [a, b] of pairs) {
        pen.moveTo(x(a), y(a));
        pen.lineTo(x(b), y(b));
      }
      pen.strokeStyle = colour;
      pen.lineWidth = (width * canvas.width) / (canvas.clientWidth || 736);
      pen.stroke();
    };
    lines(data.edges, ink.getPropertyValue("--ink"), 0.7);
    lines(data.sticks, data.stick, 2.2);
    lines(data.joints, ink.getPropertyValue("--ink"), 1.3);
    lines(data.forces, ink.getPropertyValue("--blue"), 1.6);
    pen.strokeStyle = ink.getPropertyValue("--ink");
    pen.fillStyle = ink.getPropertyValue("--paper");
    pen.lineWidth = (1.3 * canvas.width) / (canvas.clientWidth || 736);
    for (const i of data.pins) {
      pen.beginPath();
      pen.arc(x(i), y(i), (3.6 * canvas.width) / (canvas.clientWidth || 736), 0, 2 * Math.PI);
      pen.fill();
      pen.stroke();
    }
    slider.value = frame;
    clock.value = data.clock[frame];
    slider.setAttribute("aria-valuetext", clock.value);
  };
  const pause = () => {
    began = null;
    button.textContent = "Play";
  };
  const step = (now) => {
    if (began === null) return;
    const through = Math.max(0, now - began) / (1000 * data.seconds); // a frame's time may be before that of the click
    if (through >= 1) {
      began = now;
      rounds -= 1;
    }
    draw(through >= 1 ? data.t.length - 1 : Math.floor(through * data.t.length));
    if (rounds > 0) requestAnimationFrame(step);
    else pause();
  };
  const play = (count) => {
    const from = fresh ? 0 : Number(slider.value) % Math.max(1, data.t.length - 1);
    fresh = false;
    rounds = count;
    began = performance.now() - (1000 * data.seconds * from) / data.t.length;
    button.textContent = "Pause";
    requestAnimationFrame(step);
  };
  button.addEventListener("click", () => (began === null ? play(Infinity) : pause()));
  slider.addEventListener("input", () => {
    pause();
    fresh = false;
    draw(Number(slider.value));
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => draw(Number(slider.value)));
  movie.querySelector(".controls").hidden = false;
  draw(Number(slider.value));
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) {
    const watcher = new IntersectionObserver((seen) => {
      if (!seen[0].isIntersecting) return;
      watcher.disconnect();
      if (began === null) play(1);
    });
    watcher.observe(canvas);
  }
}
