// Residuals of the newest minute: how large they are, and whether they repeat.

import { css, h, pen, say } from "../dom.js";
import { spreadInUnit } from "../format.js";
import { autocorrelation, histogram, quantile, whiteBound } from "../statistics.js";
import { shown as shownUnit } from "../units.js";

const LAGS = 20;

/** Both cards; `draw(residuals, noise)` in the service's unit. */
export function drawnResiduals() {
  const spread = h("canvas.bars", { role: "img", "aria-label": "Histogram of the residuals" }), follow = h("canvas.bars", { role: "img", "aria-label": "Autocorrelation of the residuals" });
  const spreadWords = h("p.words"), followWords = h("p.words");
  const element = h("div.grid.two", {},
    h("section.card", {}, h("header", {}, h("h2", {}, "Residuals, how large")), spread, spreadWords),
    h("section.card", {}, h("header", {}, h("h2", {}, "Residuals, do they repeat")), follow, followWords));

  function drawSpread(bySelected, noise) {
    const { context, width, height } = pen(spread);
    if (bySelected.length < 20) { say(spreadWords, `collecting: ${bySelected.length} of 20`); return; }
    const limit = Math.max(quantile(bySelected.map(Math.abs), 0.99) * 1.15, 1e-9), bins = 31;
    const shares = histogram(bySelected, limit, bins), highest = Math.max(...shares);
    const base = height - 14;
    context.fillStyle = css("--line-1");
    shares.forEach((share, k) => {
      const bar = (share / highest) * (base - 6);
      context.fillRect((k * width) / bins + 0.5, base - bar, width / bins - 1, bar);
    });
    if (noise > 0) { // what white noise of the published size would look like
      context.strokeStyle = css("--ink"); context.lineWidth = 1.5; context.beginPath();
      for (let x = 0; x <= width; x += 2) {
        const e = (x / width) * 2 * limit - limit;
        const share = ((2 * limit) / bins) * Math.exp(-0.5 * (e / noise) ** 2) / (noise * Math.sqrt(2 * Math.PI));
        context.lineTo(x, base - Math.min(share / highest, 1.1) * (base - 6));
      }
      context.stroke();
    }
    axisText(context, width, height, [`−${spreadInUnit(limit, "l/min", 1)}`, "0", `${spreadInUnit(limit, "l/min", 1)} ${shownUnit("l/min")}`]);
    const mean = bySelected.reduce((a, b) => a + b, 0) / bySelected.length;
    say(spreadWords, `${bySelected.length} residuals; mean ${spreadInUnit(mean, "l/min", 2)}, noise ${spreadInUnit(noise, "l/min", 2)} ${shownUnit("l/min")} (line)`);
  }

  function drawFollow(bySelected) {
    const { context, width, height } = pen(follow);
    if (bySelected.length < 60) { say(followWords, `collecting: ${bySelected.length} of 60`); return; }
    const found = autocorrelation(bySelected, LAGS), bound = whiteBound(bySelected.length);
    const middle = (height - 14) / 2, y = (r) => middle - r * (middle - 2);
    context.fillStyle = `${css("--soft")}33`;
    context.fillRect(0, y(bound), width, y(-bound) - y(bound));
    found.forEach((r, k) => {
      context.fillStyle = Math.abs(r) > bound ? css("--warning") : css("--line-1");
      context.fillRect((k * width) / LAGS + 2, Math.min(y(r), middle), width / LAGS - 4, Math.max(Math.abs(y(r) - middle), 1));
    });
    axisText(context, width, height, ["lag 1", "", `${LAGS}`]);
    const outside = found.filter((r) => Math.abs(r) > bound).length;
    say(followWords, outside <= 2
      ? `White: ${LAGS - outside} of ${LAGS} lags within the grey band of chance.`
      : `Not white: ${outside} of ${LAGS} lags are larger than chance (grey).`);
  }

  return { element, draw: (residuals, noise) => { drawSpread(residuals, noise); drawFollow(residuals); } };
}

function axisText(context, width, height, [left, middle, right]) {
  context.fillStyle = css("--soft");
  context.font = "11px system-ui, sans-serif";
  context.textBaseline = "bottom";
  for (const [text, x, align] of [[left, 0, "left"], [middle, width / 2, "center"], [right, width, "right"]]) {
    context.textAlign = align;
    context.fillText(text, x, height);
  }
}
