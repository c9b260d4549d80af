// What the modules of the page compute without a browser; run by test_script.py.
import assert from "node:assert/strict";
import { test } from "node:test";

const page = new URL(process.env.TERMSEL_PAGE);
const { coordinate, measurement, pixel, sized } = await import(new URL("panel.js", page).href);
const { Refusal, call, newest } = await import(new URL("server.js", page).href);

test("sizes are rounded as on the screens of termsel", () => {
  assert.deepEqual([0.00123456, 0.123456, 12.3456, 999.6, 12345.6, NaN, Infinity].map(sized),
    ["0.0012", "0.12", "12.3", "1,000", "12,346", "-", "-"]);
});

test("degrees have six digits, metres two, and what is not known is blank", () => {
  assert.deepEqual([48.5, 512300.5, 0, null, undefined].map(coordinate), ["48.500000", "512300.50", "0.00", "", ""]);
  assert.deepEqual([1.005, undefined, null].map(pixel), ["1.00", "", ""]);
});

test("fields show a thousandth of a pixel, a millimetre, and nine digits of a degree", () => {
  assert.deepEqual([measurement(67.90031014, true), measurement(271576.04135947884, false), measurement(48.516123456789, false),
    measurement(null, true)], ["67.9", "271576.041", "48.516123457", ""]);
});

test("what is refused says what to do", async () => {
  globalThis.fetch = async () => ({ ok: false, status: 422, json: async () => ({ error: "No.", hint: "Do this." }) });
  await assert.rejects(call("put"), error => error instanceof Refusal && error.message === "No. Do this.");
  globalThis.fetch = async () => ({ ok: false, status: 500, json: async () => { throw new SyntaxError(); } });
  await assert.rejects(call("put"), /refuses this \(500\)/);
  globalThis.fetch = async () => { throw new TypeError("network"); };
  await assert.rejects(call("put"), /does not answer.*Nothing is lost/);
});

test("a request is JSON to the page's own folder", async () => {
  const asked = [];
  globalThis.fetch = async (...given) => { asked.push(given); return { ok: true, json: async () => ({ id: "P01" }) }; };
  assert.deepEqual(await call("put", { image: [1, 2] }), { id: "P01" });
  assert.deepEqual(asked, [["call/put", { method: "POST", headers: { "Content-Type": "application/json" },
    body: '{"image":[1,2]}' }]]);
});

test("of many questions the newest is asked, one at a time", async () => {
  const asked = [];
  const waiting = [];
  globalThis.fetch = (_, given) => new Promise(done => {
    asked.push(JSON.parse(given.body).n);
    waiting.push(() => done({ ok: true, json: async () => ({ n: asked.at(-1) }) }));
  });
  const taken = [];
  const ask = newest("predict", answer => taken.push(answer.n));
  for (const n of [1, 2, 3]) ask({ n });
  assert.deepEqual(asked, [1]);
  waiting.shift()();
  await new Promise(setImmediate);
  assert.deepEqual(asked, [1, 3]);
  waiting.shift()();
  await new Promise(setImmediate);
  assert.deepEqual(taken, [3]); // the first had been superseded
});
