// Poses for the player, decoded by a worker on request, with a cache.
"use strict";

/**
 * Make a source of poses from the script that decodes them. `ask(ask, about)` sends a request to the decoder;
 * `want(requests)` sets the wanted poses {mesh, pose, time, measure, top}, the most urgent first; `find(request)` returns
 * such a pose, undefined if it is not decoded yet; `seconds()` is the mean time in which a pose is decoded. `onPose()` is called for every decoded pose, `onError(error)` on failure.
 */
var mixseqPoseSource = function (script, onPose, onError) {
  const MAX_CACHE_BYTES = 3e8, MAX_PENDING = 2; // pending requests keep the worker busy
  const cache = new Map(), waiting = [];
  let worker = newWorker(), local = null, wanted = [], cacheBytes = 0, pending = new Set(), answered = 0, milliseconds = null;

  function newWorker() {
    try {
      const made = new Worker(URL.createObjectURL(new Blob([script], { type: "text/javascript" })));
      made.onmessage = ({ data }) => waiting.shift().take(data);
      made.onerror = decodeLocally; // some browsers forbid workers in local files
      return made;
    } catch {
      return null;
    }
  }

  /** Decode in the page if there is no worker. */
  function decodeLocally() {
    worker = null;
    waiting.splice(0).forEach(({ request, take }) => answerLocally(request, take));
  }

  function answerLocally(request, take) {
    if (!local) document.head.append(Object.assign(document.createElement("script"), { textContent: script }));
    local = mixseqPoses;
    setTimeout(async () => take(await local.answer(request)));
  }

  function ask(ask, about) {
    return new Promise((resolve, reject) => {
      const take = (answer) => (answer.error ? reject(new Error(answer.error)) : resolve(answer));
      if (!worker) return answerLocally({ ask, about }, take);
      waiting.push({ request: { ask, about }, take });
      worker.postMessage({ ask, about });
    });
  }

  const key = ({ mesh, pose, measure }) => `${mesh} ${pose} ${measure ?? ""}`;
  const find = (request) => cache.get(key(request));

  function want(requests) {
    wanted = requests;
    requestNext();
  }

  function requestNext() {
    for (const request of wanted) {
      const name = key(request);
      if (pending.size >= MAX_PENDING) return;
      if (cache.has(name) || pending.has(name)) continue;
      pending.add(name);
      const sent = performance.now();
      ask("pose", request).then((pose) => {
        measure(sent);
        store(name, { ...pose, frame: request.frame });
      }, onError);
    }
  }

  /** Update the mean time per pose; the first one is left out, with which the mesh is decoded. */
  function measure(sent) {
    const now = performance.now(), time = now - Math.max(sent, answered);
    milliseconds = milliseconds === null ? 0 : 0.8 * milliseconds + 0.2 * time;
    answered = now;
  }

  function store(name, pose) {
    pending.delete(name);
    cache.set(name, pose);
    cacheBytes += sizeOf(pose);
    const needed = new Set(wanted.map(key));
    for (const [old, each] of cache) {
      if (cacheBytes < MAX_CACHE_BYTES) break;
      if (needed.has(old)) continue;
      cache.delete(old);
      cacheBytes -= sizeOf(each);
    }
    onPose();
    requestNext();
  }

  const sizeOf = ({ places, colours }) => 2 * places.byteLength + (colours?.length ?? 0);

  return { ask, want, find, seconds: () => milliseconds / 1000 };
};
