// Where the player has its poses from: a worker decodes them as they are wanted, and what was decoded is kept for a while.
"use strict";

/**
 * Make a source of poses from the text of what decodes them. `ask(ask, about)` asks it anything; `want(requests)` tells
 * which poses are wanted, the most urgent first, each {mesh, pose, time, measure, top}; `find(request)` is such a pose,
 * or undefined if it is not there yet. `changed()` is told about every pose that comes, `failed(error)` what went wrong.
 */
var mixseqPoseSource = function (script, changed, failed) {
  const MEMORY = 3e8, AT_ONCE = 2; // bytes that are kept; questions that wait at the worker
  const kept = new Map(), waiting = [];
  let worker = newWorker(), here = null, wanted = [], used = 0, asked = new Set();

  function newWorker() {
    try {
      const made = new Worker(URL.createObjectURL(new Blob([script], { type: "text/javascript" })));
      made.onmessage = ({ data }) => waiting.shift().take(data);
      made.onerror = workHere; // some browsers have none for pages from files
      return made;
    } catch {
      return null;
    }
  }

  /** Without a worker the page does it, a question at a time. */
  function workHere() {
    worker = null;
    waiting.splice(0).forEach(({ question, take }) => answerHere(question, take));
  }

  function answerHere(question, take) {
    if (!here) document.head.append(Object.assign(document.createElement("script"), { textContent: script }));
    here = mixseqPoses;
    setTimeout(async () => take(await here.answer(question)));
  }

  function ask(ask, about) {
    return new Promise((resolve, reject) => {
      const take = (said) => (said.error ? reject(new Error(said.error)) : resolve(said));
      if (!worker) return answerHere({ ask, about }, take);
      waiting.push({ question: { ask, about }, take });
      worker.postMessage({ ask, about });
    });
  }

  const key = ({ mesh, pose, measure }) => `${mesh} ${pose} ${measure ?? ""}`;
  const find = (request) => kept.get(key(request));

  function want(requests) {
    wanted = requests;
    pump();
  }

  function pump() {
    for (const request of wanted) {
      const name = key(request);
      if (asked.size >= AT_ONCE) return;
      if (kept.has(name) || asked.has(name)) continue;
      asked.add(name);
      ask("pose", request).then((pose) => keep(name, { ...pose, number: request.pose }), failed);
    }
  }

  function keep(name, pose) {
    asked.delete(name);
    kept.set(name, pose);
    used += sizeOf(pose);
    const needed = new Set(wanted.map(key));
    for (const [old, each] of kept) {
      if (used < MEMORY) break;
      if (needed.has(old)) continue;
      kept.delete(old);
      used -= sizeOf(each);
    }
    changed();
    pump();
  }

  const sizeOf = ({ places, colours }) => 2 * places.byteLength + (colours?.length ?? 0);

  return { ask, want, find };
};
