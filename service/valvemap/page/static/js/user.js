// Who is logged in, and what may be done in that name.

import { inUnits } from "./units.js";

const AGAIN_MS = 1000; // until a right is asked for again that the service did not tell
const BESIDE = ["comment", "event"]; // of a command: they change nothing of who may

class User extends EventTarget {
  name = null;
  mayLogIn = false;
  hasRig = false;
  #turn = 0; // counts log-ins and log-outs
  #isChanging = false;
  #rights = new Map(); // by what a command is about: whether the service would let the user
  #dialog = document.querySelector("dialog.log-in");
  #button = document.querySelector("button.user");

  constructor() {
    super();
    const form = this.#dialog.querySelector("form"), problem = form.querySelector(".problem");
    this.#button.addEventListener("click", () => (this.name ? this.#logOut() : this.ask()));
    form.querySelector(".cancel").addEventListener("click", () => this.#dialog.close());
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      problem.textContent = "";
      const { user, password } = Object.fromEntries(new FormData(form));
      const answer = await this.#change("log-in", { user, password });
      if (!answer) return;
      form.elements.password.value = "";
      if (answer.error) { problem.textContent = answer.error; return; }
      if (!this.#dialog.open) { await this.#logOut(); return; } // it was cancelled meanwhile
      this.#dialog.close();
      this.#take(answer);
    });
    this.refresh();
  }

  ask() {
    if (!this.mayLogIn) { alert("Nobody can log in here: the page is open to the network without https."); return; }
    this.#dialog.showModal();
  }

  async refresh() {
    const turn = this.#turn;
    try {
      const answer = await (await fetch("user")).json();
      if (turn === this.#turn) this.#take(answer);
    } catch { /* the link says what is wrong */ }
  }

  /** Carry out a command; returns an error's text, or null. */
  async command(command) {
    const turn = this.#turn, answer = await post("command", command);
    if (answer.status === 401 && turn === this.#turn) this.#take({ user: null });
    return answer.error ? inUnits(answer.error) : null;
  }

  /** Why the user may not carry out a command; "" where the service would let them. */
  mayNot(command) {
    const about = aboutOf(command), right = this.#rights.get(about);
    if (right === undefined) this.#askFor(about, command);
    return right === true ? "" : right === false ? `${this.name} may not do this: log in as a user with the role Operator.` : `Asking whether ${this.name} may do this …`;
  }

  /** Whether the service has not told yet if it would let the user. */
  isAsking(command) { return typeof this.#rights.get(aboutOf(command)) !== "boolean"; }

  /** Ask anew what the user may, as after the service was away. */
  forgetRights() { this.#rights.clear(); }

  async #askFor(about, command) {
    const rights = this.#rights;
    rights.set(about, null);
    const { status, may } = await post("may", command);
    if (rights !== this.#rights) return; // of another user
    if (status === 401) this.#take({ user: null });
    else if (may === undefined) setTimeout(() => rights.delete(about), AGAIN_MS);
    else {
      rights.set(about, may);
      this.dispatchEvent(new Event("rights"));
    }
  }

  async #logOut() {
    const answer = await this.#change("log-out", {});
    if (!answer) return;
    if (!answer.error) this.#take(answer);
    else if (this.name) alert(`${this.name} is still logged in: ${answer.error}.`);
  }

  /** Log in or out, one at a time; undefined while another one is under way. What was asked of the user before says nothing of the one after. */
  async #change(path, body) {
    if (this.#isChanging) return undefined;
    this.#isChanging = true;
    const answer = await post(path, body);
    this.#turn += 1;
    this.#isChanging = false;
    return answer;
  }

  #take({ user = null, mayLogIn = this.mayLogIn, hasRig = this.hasRig }) {
    if (user !== this.name) this.#rights = new Map();
    Object.assign(this, { name: user, mayLogIn, hasRig });
    this.#button.textContent = user ? `${user} · log out` : "Log in";
    this.dispatchEvent(new Event("change"));
  }
}

/** What a command is about: of its other values nothing changes who may. */
const aboutOf = (command) => JSON.stringify(Object.entries(command).filter(([name, value]) => typeof value === "string" && !BESIDE.includes(name)));

async function post(path, body) {
  try {
    const response = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
    return { status: response.status, ...(await response.json().catch(() => ({ error: `refused (${response.status})` }))) };
  } catch {
    return { error: "the page's server does not answer" };
  }
}

export const user = new User();
