// A button for each page. A page is loaded when it is first chosen, and goes to where the one before was.
(() => {
  "use strict";
  const { titles, pages } = JSON.parse(document.getElementById("pages").textContent);
  const bar = document.querySelector("nav"), place = document.querySelector("main");
  const panelOf = (frame) => frame?.contentDocument?.getElementById("holdfast");
  let shown = null;

  const buttons = titles.map((title, k) => {
    const button = bar.appendChild(document.createElement("button"));
    button.textContent = title;
    button.onclick = () => choose(k);
    return button;
  });

  const frames = pages.map(() => null);
  function framed(k) {
    const frame = Object.assign(document.createElement("iframe"), { srcdoc: pages[k], title: titles[k] });
    frame.onload = () => frame.contentWindow.addEventListener("keydown", byNumber);
    return place.appendChild(frame);
  }

  function choose(k) {
    const before = shown, seen = panelOf(before)?.seen?.();
    frames[k] ??= framed(k);
    shown = frames[k];
    for (const frame of frames) frame?.classList.toggle("shown", frame === shown);
    buttons.forEach((button, i) => button.setAttribute("aria-pressed", i === k));
    if (seen && shown !== before) follow(shown, seen);
    shown.focus();
  }

  // the page may still be loading
  function follow(frame, seen) {
    if (frame === shown && !panelOf(frame)?.see?.(seen)) setTimeout(() => follow(frame, seen), 50);
  }

  function byNumber(event) {
    const k = Number(event.key) - 1;
    if (k in pages && event.target.tagName !== "INPUT") choose(k);
  }
  window.addEventListener("keydown", byNumber);
  choose(0);
})();
