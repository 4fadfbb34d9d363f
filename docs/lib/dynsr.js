// Sets every formula that pymdownx.arithmatex has marked, \(inline\) or \[on a line of its own\].
for (const place of document.querySelectorAll(".arithmatex")) {
  const text = place.textContent.trim();
  katex.render(text.slice(2, -2), place, { displayMode: text.startsWith("\\["), throwOnError: false });
}
// Outputs of notebooks hold formulas between dollars, as notebooks have them.
for (const output of document.querySelectorAll(".jp-OutputArea-output")) {
  renderMathInElement(output, { delimiters: [
    { left: "$$", right: "$$", display: true },
    { left: "$", right: "$", display: false },
  ] });
}
