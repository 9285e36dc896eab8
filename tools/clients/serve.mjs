// What pages are opened with: a server of this folder on a port of its own, and Chromium with WebGL in software.
import { createServer } from "node:http";
import { readFile } from "node:fs/promises";
import { extname, join, normalize } from "node:path";
import { chromium } from "playwright-core";

const HERE = import.meta.dirname;
const TYPES = { ".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript", ".wasm": "application/wasm" };
const OPTIONS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic",
  "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"];

export const server = createServer(async (request, response) => {
  const path = normalize(decodeURIComponent(request.url.split("?")[0]));
  try {
    const content = await readFile(join(HERE, path));
    response.writeHead(200, { "Content-Type": TYPES[extname(path)] ?? "application/octet-stream" }).end(content);
  } catch {
    response.writeHead(404).end();
  }
});
await new Promise(done => server.listen(0, "127.0.0.1", done));
export const origin = `http://127.0.0.1:${server.address().port}`;
export const browser = await chromium.launch({ executablePath: process.env.FROG_CHROMIUM, args: OPTIONS });
