// Returns what is wrong with the labels of a page's charts: faint, cut off, or over one another.
const light = (colour) => {
  const [r, g, b] = colour.match(/[\d.]+/g).slice(0, 3).map((part) => {
    const c = part / 255;
    return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const contrast = (one, other) => {
  const [dark, bright] = [light(one), light(other)].sort((a, b) => a - b);
  return (bright + 0.05) / (dark + 0.05);
};
const ground = getComputedStyle(document.body).backgroundColor;
const wrong = [];
for (const svg of document.querySelectorAll(".chart svg")) {
  const around = svg.getBoundingClientRect();
  const say = (what) => wrong.push(`${svg.closest("figure").id}: ${what}`);
  // A rim around a label has the colour of the page.
  const labels = [...svg.querySelectorAll("text")].filter((label) => label.textContent.trim()
    && label.getAttribute("opacity") !== "0" && getComputedStyle(label).fill !== ground);
  const boxes = labels.map((label) => label.getBoundingClientRect());
  labels.forEach((label, i) => {
    const { left, right, top, bottom } = boxes[i];
    const said = label.textContent;
    if (contrast(getComputedStyle(label).fill, ground) < 4.5) say(`${said} is faint`);
    if (left < around.left - 1 || right > around.right + 1 || top < around.top - 1
        || bottom > around.bottom + 1) say(`${said} is cut off`);
    boxes.slice(0, i).forEach((other, j) => {
      const wide = Math.min(right, other.right) - Math.max(left, other.left);
      const high = Math.min(bottom, other.bottom) - Math.max(top, other.top);
      if (wide > 1 && high > 3) say(`${said} is over ${labels[j].textContent}`);
    });
  });
}
return wrong;
