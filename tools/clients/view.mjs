// Pictures of files in web viewers: node view.mjs JOBS.json, in a folder with node_modules and the files beside it.
// A job has what viewers.js wants, or the url of a page that draws by itself and says so at its root (data-shown), and
// the picture's path and size. A line of JSON is printed for each: what the viewer said, and an error that ended it.
import { writeFile } from "node:fs/promises";
import { readFileSync } from "node:fs";
import { browser, origin, server } from "./serve.mjs";

const PATIENCE = 120_000, MOST_PICTURES = 6;

/** A second between frames: in software one takes as long, and pictures have to be taken between them. */
function slowly() {
  const soon = requestAnimationFrame.bind(window);
  window.requestAnimationFrame = draw => setTimeout(() => soon(draw), 1000);
}

/** A picture that is the same as the one before: everything is sorted and drawn. */
async function settled(page) {
  let before = await page.screenshot();
  for (let count = 0; count < MOST_PICTURES; count++) {
    await page.waitForTimeout(3000);
    const now = await page.screenshot();
    if (count > 0 && now.equals(before)) return now;
    before = now;
  }
  return before;
}

for (const job of JSON.parse(readFileSync(process.argv[2], "utf8"))) {
  const context = await browser.newContext({ viewport: { width: job.width, height: job.height } });
  const page = await context.newPage(), said = [];
  page.on("pageerror", error => said.push(error.message));
  page.on("console", message => message.type() === "error" && said.push(message.text()));
  page.setDefaultTimeout(PATIENCE);
  try {
    if (job.viewer) {
      await page.addInitScript(slowly);
      await page.goto(`${origin}/view.html`);
      await page.waitForSelector("html[data-ready]", { state: "attached" });
      const drawn = page.evaluate(job => window.draw(job), job);
      const late = new Promise((_, fail) => setTimeout(() => fail(new Error("nothing in two minutes")), PATIENCE).unref());
      await Promise.race([drawn, late]);
    } else {
      await page.goto(origin + job.url);
      await page.waitForSelector("html[data-shown]", { state: "attached" });
    }
    const picture = await settled(page);
    await writeFile(job.picture, picture);
    console.log(JSON.stringify({ said }));
  } catch (error) {
    console.log(JSON.stringify({ error: error.message.replace("page.evaluate: ", "").split("\n")[0], said }));
  }
  await context.close();
}
await browser.close();
server.close();
