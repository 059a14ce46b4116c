for (const root of document.querySelectorAll("[data-report]"))
  showViews(root, JSON.parse(root.querySelector("script[type='application/json']").textContent));
