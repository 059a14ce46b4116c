// Cancels or removes a session, once somebody has confirmed it.
import { html } from "./views.js";
import { remove } from "./api.js";

const KINDS = {
  cancel: {
    title: "Cancel this session?", text: "Its robot is told at its next call. The estimate stays as it is, and the session can still be read.",
    yes: "Cancel the session", no: "Let it go on", query: "", done: "is cancelled",
  },
  purge: {
    title: "Remove this session?", text: "Everything that is stored of it is lost: its depth image, its scans and its estimate. If it is under way, it is cancelled first.",
    yes: "Remove it for good", no: "Keep it", query: "?purge=true", done: "is removed",
  },
};

/** A function that asks before it ends the session; `kind` is `cancel` or `purge`. */
export function askToEnd(path, name, announce) {
  return (kind) => {
    const { title, text, yes, no, query, done } = KINDS[kind];
    const failure = html("p", { class: "warning", role: "alert", hidden: "" });
    const confirm = html("button", { type: "button", class: "danger" }, yes), keep = html("button", { type: "button", autofocus: "" }, no);
    const dialog = html("dialog", { "aria-labelledby": "question" }, html("h2", { id: "question" }, title), html("p", {}, html("code", {}, name)), html("p", {}, text), failure, html("p", { class: "controls" }, keep, confirm));
    const opener = document.activeElement;
    dialog.addEventListener("close", () => {
      dialog.remove();
      opener?.focus();
    });
    keep.addEventListener("click", () => dialog.close());
    confirm.addEventListener("click", async () => {
      confirm.disabled = true;
      try {
        await remove(path + query);
      } catch (error) {
        failure.textContent = error.message;
        failure.hidden = false;
        confirm.disabled = false;
        return;
      }
      dialog.close();
      if (kind === "purge") location.hash = "#/sessions";
      announce(`Session ${name} ${done}.`);
    });
    document.body.append(dialog);
    dialog.showModal();
  };
}
