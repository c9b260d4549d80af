// @ts-check
/** What the page asks the server for, and hears from it. */

/**
 * A refusal that the user can correct: what is wrong and what to do.
 */
export class Refusal extends Error {
  /** @param {{error?: string, hint?: string}} answer */
  constructor(answer) {
    super([answer.error, answer.hint].filter(Boolean).join(" "));
  }
}

/**
 * Have the server do or tell something.
 * @param {string} name
 * @param {object} [given]
 * @returns {Promise<any>}
 */
export async function call(name, given = {}) {
  let response;
  try {
    response = await fetch(`call/${name}`, {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(given),
    });
  } catch {
    throw new Refusal({ error: "termsel app does not answer.", hint:
      "Was it ended? Nothing is lost: start the same command again, and open its new address." });
  }
  const answer = await response.json().catch(() => ({}));
  if (response.ok) return answer;
  throw new Refusal(answer.error ? answer : { error: `The server refuses this (${response.status}).` });
}

/**
 * Ask for the newest of many questions: while one is on its way, only the last of the others waits.
 * @param {string} name
 * @param {(answer: any) => void} take
 * @returns {(given: object) => void}
 */
export function newest(name, take) {
  /** @type {object | null} */
  let waiting = null;
  let asking = false;
  return async function ask(given) {
    waiting = given;
    if (asking) return;
    asking = true;
    while (waiting) {
      const question = waiting;
      waiting = null;
      try {
        const answer = await call(name, question);
        if (!waiting) take(answer);
      } catch {
        waiting = null; // what follows the cursor is no work of the user's
      }
    }
    asking = false;
  };
}

/**
 * Hear of all changes, and again after the connection was lost.
 * @param {(message: any) => void} take
 * @param {(lost: boolean) => void} said
 */
export function listen(take, said) {
  const place = new URL("events", location.href);
  place.protocol = "ws:";
  const socket = new WebSocket(place);
  socket.onmessage = event => take(JSON.parse(event.data));
  socket.onopen = () => said(false);
  socket.onclose = () => {
    said(true);
    setTimeout(() => listen(take, said), 2000);
  };
}
