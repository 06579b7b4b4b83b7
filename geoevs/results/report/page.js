"use strict";

const read = (id) => JSON.parse(document.getElementById(id).textContent);

// Charts are drawn when they come into view.
const charts = read("charts-data");
const seen = new IntersectionObserver((entries) => {
  for (const { isIntersecting, target } of entries) {
    if (!isIntersecting) continue;
    seen.unobserve(target);
    const actions = { export: true, source: false, compiled: false, editor: false };
    // Within, as vega-embed gives what it fills a width of its own.
    const within = target.appendChild(document.createElement("div"));
    // ast: expressions are interpreted, as the page's policy forbids scripts made from text.
    const options = { actions, renderer: "svg", ast: true };
    vegaEmbed(within, charts[target.dataset.chart], options).catch(console.error);
  }
}, { rootMargin: "200px" });
document.querySelectorAll(".chart").forEach((element) => seen.observe(element));

// Pictures: four lists narrow down to one view, two more choose what is compared.
const { images, views, featured } = read("compare-data");
const form = document.getElementById("choice");
const slider = document.getElementById("slider");
const caption = document.getElementById("caption");
const STEPS = ["split", "scene", "frame", "view"];
const EVIDENCE = ["truth", "sparse reference"];
const loaded = new Map();

function place(view, step) {
  return step === "scene" ? `${view.dataset}/${view.scene}` : String(view[step]);
}

function fill(select, values, preferred) {
  const kept = values.includes(select.value) ? select.value : preferred;
  select.replaceChildren(...values.map((value) => new Option(value, value)));
  if (values.includes(kept)) select.value = kept;
}

function chosenView() {
  let left = views;
  for (const step of STEPS) {
    const select = form.elements[step];
    const first = step === "split" ? "extrapolation" : undefined;
    fill(select, [...new Set(left.map((view) => place(view, step)))], first);
    left = left.filter((view) => place(view, step) === select.value);
  }
  return left[0];
}

function pixels(number) {
  if (!loaded.has(number)) {
    loaded.set(number, (async () => {
      const image = new Image();
      image.src = images[number];
      await image.decode();
      const canvas = new OffscreenCanvas(image.width, image.height);
      const context = canvas.getContext("2d");
      context.drawImage(image, 0, 0);
      return context.getImageData(0, 0, image.width, image.height);
    })());
  }
  return loaded.get(number);
}

// The absolute difference, averaged over channels, from black over red and yellow to white at 0.25.
// Transparent pixels are unknown and stay black; a black pixel may well be known.
function errorMap(picture, answer) {
  const map = new ImageData(picture.width, picture.height);
  for (let at = 0; at < map.data.length; at += 4) {
    const known = picture.data[at + 3] > 0 && answer.data[at + 3] > 0;
    let error = 0;
    for (let channel = 0; channel < 3; channel++) {
      error += Math.abs(picture.data[at + channel] - answer.data[at + channel]) / 3;
    }
    const heat = known ? Math.min(1, error / 64) * 765 : 0;
    for (let channel = 0; channel < 3; channel++) {
      map.data[at + channel] = Math.max(0, Math.min(255, heat - 255 * channel));
    }
    map.data[at + 3] = 255;
  }
  return map;
}

function blend(picture, overlay) {
  const mixed = new ImageData(picture.width, picture.height);
  for (let at = 0; at < mixed.data.length; at++) {
    mixed.data[at] = at % 4 === 3 ? 255 : (picture.data[at] + overlay.data[at]) / 2;
  }
  return mixed;
}

async function drawn(view, name) {
  let picture = await pixels(view.pictures[name]);
  const answer = EVIDENCE.find((evidence) => evidence in view.pictures);
  if (form.elements.error.checked && answer) {
    picture = errorMap(picture, await pixels(view.pictures[answer]));
  }
  if (form.elements.overlay.checked && view.overlay !== null) {
    picture = blend(picture, await pixels(view.overlay));
  }
  return picture;
}

function described(view, name) {
  const scores = Object.entries(view.scores[name] ?? {});
  const text = scores.map(([metric, value]) => `${metric} ${value} dB`).join(", ");
  return text ? `${name} (${text})` : name;
}

let request = 0;
async function show() {
  const mine = ++request;
  const view = chosenView();
  if (!view) return;
  const names = Object.keys(view.pictures);
  const entrants = names.filter((name) => !EVIDENCE.includes(name));
  const right = entrants.includes(featured) ? featured : entrants.at(-1);
  fill(form.elements.left, names, names[0]);
  fill(form.elements.right, names, right);
  const sides = [form.elements.left.value, form.elements.right.value];
  const pictures = await Promise.all(sides.map((name) => drawn(view, name)));
  if (mine !== request) return;
  ["first", "second"].forEach((id, side) => {
    const canvas = document.getElementById(id);
    canvas.width = pictures[side].width;
    canvas.height = pictures[side].height;
    canvas.getContext("2d").putImageData(pictures[side], 0, 0);
  });
  caption.textContent = `Left: ${described(view, sides[0])}. Right: ${described(view, sides[1])}.`;
  form.elements.overlay.disabled = view.overlay === null;
}

// Flicker shows one side, then the other; where motion is unwelcome, at each press.
const still = matchMedia("(prefers-reduced-motion: reduce)");
let timer = null;
const turn = () => { slider.value = slider.value < 50 ? 100 : 0; };
form.elements.flicker.addEventListener("click", ({ currentTarget }) => {
  if (still.matches) return turn();
  const start = timer === null;
  if (start) {
    turn();
    timer = setInterval(turn, 600);
  } else {
    clearInterval(timer);
    timer = null;
    slider.value = 50;
  }
  currentTarget.setAttribute("aria-pressed", String(start));
});
form.addEventListener("change", show);
form.addEventListener("submit", (event) => event.preventDefault());
show();
