// A button on each block of code that copies it; of a console session, the commands alone.
document.addEventListener("DOMContentLoaded", () => {
  if (!navigator.clipboard) return; // a page that came over plain HTTP from another machine
  for (const block of document.querySelectorAll("div.highlight")) {
    const session = block.parentElement.classList.contains("highlight-console");
    const button = document.createElement("button");
    button.className = "copy";
    button.textContent = "Copy";
    button.addEventListener("click", async () => {
      const text = block.querySelector("pre").textContent;
      const commands = text.split("\n").filter((line) => line.startsWith("$ "));
      await navigator.clipboard.writeText(session ? commands.map((line) => line.slice(2)).join("\n") : text);
      button.textContent = "Copied";
    });
    block.addEventListener("mouseleave", () => (button.textContent = "Copy"));
    block.append(button);
  }
});
