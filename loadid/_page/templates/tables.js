for (const head of document.querySelectorAll("th[data-sort]")) {
  const sort = () => {
    const body = head.closest("table").tBodies[0], at = head.cellIndex, up = head.dataset.up !== "yes";
    for (const other of head.parentNode.cells) { delete other.dataset.up; other.removeAttribute("aria-sort"); }
    head.dataset.up = up ? "yes" : "no";
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    const key = row => row.cells[at].dataset.v ?? row.cells[at].textContent;
    const order = (a, b) => {
      const x = key(a), y = key(b), d = x - y;
      return (Number.isNaN(d) ? x.localeCompare(y) : d) * (up ? 1 : -1);
    };
    body.append(...[...body.rows].sort(order));
  };
  head.tabIndex = 0;
  head.addEventListener("click", sort);
  head.addEventListener("keydown", e => { if (e.key === "Enter" || e.key === " ") { e.preventDefault(); sort(); } });
}
