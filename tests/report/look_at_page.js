// Looks at the page in each frame once all have loaded, and writes what it saw as JSON.

function rgb(text) {
  const [red, green, blue, alpha = 1] = text.match(/[\d.]+/g).map(Number);
  return { red, green, blue, alpha };
}

function luminance(colour) {
  const part = (x) => ((x /= 255) <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
  return 0.2126 * part(colour.red) + 0.7152 * part(colour.green) + 0.0722 * part(colour.blue);
}

function behind(element, view) {
  for (let one = element; one; one = one.parentElement) {
    const colour = rgb(view.getComputedStyle(one).backgroundColor);
    if (colour.alpha > 0) return colour;
  }
  return rgb("rgb(255, 255, 255)");
}

function contrast(element, view) {
  const levels = [rgb(view.getComputedStyle(element).color), behind(element, view)].map(luminance).sort((a, b) => b - a);
  return (levels[0] + 0.05) / (levels[1] + 0.05);
}

async function look(frame) {
  const page = frame.contentDocument, view = frame.contentWindow;
  await Promise.all([...page.images].map((image) => image.decode().catch(() => null)));
  const own = (element) => [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
  const faint = [...page.body.querySelectorAll("*")]
    .filter((element) => own(element) && element.getClientRects().length && contrast(element, view) < 4.5)
    .map((element) => `${element.tagName}: ${element.textContent.trim().slice(0, 40)}`);
  const figures = [...page.images].map((image) => {
    const box = image.getBoundingClientRect();
    return { name: image.alt, natural_px: image.naturalWidth, shown_px: box.width, height_px: box.height, left_px: box.left };
  });
  const pictures = page.querySelector("#pictures");
  const pictures_px = pictures ? pictures.getBoundingClientRect().bottom : 0;
  page.querySelectorAll("details").forEach((folded) => (folded.open = true));
  const cut = [...page.body.querySelectorAll("*")]
    .filter((element) => element.clientWidth > 0 && element.scrollWidth > element.clientWidth + 1)
    .map((element) => `${element.tagName} ${element.className}: ${element.textContent.trim().slice(0, 40)}`);
  return {
    figures,
    faint,
    cut,
    pictures_px,
    overflow_px: page.documentElement.scrollWidth - page.documentElement.clientWidth,
    background: view.getComputedStyle(page.body).backgroundColor,
    resources: view.performance.getEntriesByType("resource").map((entry) => entry.name).filter((name) => !name.startsWith("data:")),
  };
}

window.addEventListener("load", async () => {
  const seen = await Promise.all([...document.querySelectorAll("iframe")].map(look));
  document.querySelector("#seen").textContent = JSON.stringify(seen);
});
