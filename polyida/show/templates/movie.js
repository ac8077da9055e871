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

  const draw = (frame) => {
    const scale = (canvas.width - 20) / data.width;
    const x = (i) => 10 + scale * places[2 * (frame * points + i)];
    const y = (i) => canvas.height - 10 - scale * places[2 * (frame * points + i) + 1];
    const ink = getComputedStyle(movie);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.lineJoin = pen.lineCap = "round";
    pen.lineWidth = canvas.width / 1500;
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
    const from = Number(slider.value) % Math.max(1, data.t.length - 1);
    rounds = count;
    began = performance.now() - (1000 * data.seconds * from) / data.t.length;
    button.textContent = "Pause";
    requestAnimationFrame(step);
  };
  button.addEventListener("click", () => (began === null ? play(Infinity) : pause()));
  slider.addEventListener("input", () => {
    pause();
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
