// Set the formulas: elements of class "arithmatex" hold \(...\) or \[...\].
document.querySelectorAll(".arithmatex").forEach((element) => {
  const text = element.textContent.trim();
  katex.render(text.slice(2, -2), element, { displayMode: text.startsWith("\\["), throwOnError: false });
});

// Options and file names do not break at their hyphens.
document.querySelectorAll(".md-typeset :not(pre) > code").forEach((code) => {
  if (code.children.length || !code.textContent.includes("-")) return;
  const words = code.textContent.split(" ").map((text) => Object.assign(document.createElement("span"), { className: "word", textContent: text }));
  code.replaceChildren(...words.flatMap((word, k) => (k ? [" ", word] : [word])));
});
