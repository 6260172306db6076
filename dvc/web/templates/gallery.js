(() => {
  "use strict";
  const block = document.querySelector("[data-compare]");
  if (!block) return;
  const [group, left, right] = ["group", "left", "right"].map((name) => document.getElementById(name));
  const frame = block.querySelector(".compare"), range = block.querySelector("input");
  const sides = [[left, frame.querySelector(".under")], [right, frame.querySelector(".over")]];

  const pictures = () => [...document.querySelectorAll(`[data-group="${group.value}"] img`)];
  const split = (percent) => {
    range.value = String(percent);
    frame.style.setProperty("--split", `${range.value}%`);
  };
  const show = () => {
    const there = pictures();
    for (const [select, image] of sides) {
      const picture = there.find((one) => one.dataset.name === select.value);
      const first = there.find((one) => one.dataset.name === left.value);
      image.width = Number(first.getAttribute("width"));
      image.height = Number(first.getAttribute("height"));
      image.src = picture.src;
      image.alt = picture.alt;
    }
  };
  const fill = () => {
    const names = pictures().map((one) => one.dataset.name);
    sides.forEach(([select], side) => {
      const wanted = names.includes(select.value) ? select.value : names[Math.min(side, names.length - 1)];
      select.replaceChildren(...names.map((name) => new Option(name, name)));
      select.value = wanted;
    });
    show();
  };

  group.addEventListener("change", fill);
  sides.forEach(([select]) => select.addEventListener("change", show));
  range.addEventListener("input", () => split(range.value));
  frame.addEventListener("pointermove", (event) => {
    const box = frame.getBoundingClientRect();
    split(Math.round(100 * (event.clientX - box.left) / box.width));
  });
  fill();
})();
