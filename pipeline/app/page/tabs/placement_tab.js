// Where the balls lay at a moment: rings on the picture and on the plan, to put them back.
import { html, useEffect, useState } from "../html.js";
import { read } from "../api.js";
import { useStore } from "../store.js";
import { text } from "../strings.js";

export function PlacementTab({ shot }) {
  const { rings } = useStore(shot.desk);
  const [error, setError] = useState("");
  const load = async (query) => {
    try {
      const found = await read(shot.address(`put-back${query}`));
      setError("");
      shot.player.showRow(shot.player.frames.rowOf(found.frame));
      shot.desk.set({ rings: found });
    } catch (one) {
      setError(one.message);
    }
  };
  useEffect(() => { load(""); return () => shot.desk.set({ rings: null }); }, [shot]);
  return html`<div>
    <h2>${text.placement.title}</h2>
    <div class="row"><button onClick=${() => load("")}>${text.placement.atStrike}</button>
      <button onClick=${() => load(`?frame=${shot.frame}`)}>${text.placement.atFrame}</button></div>
    ${error && html`<p role="alert">${error}</p>`}
    ${rings && html`<div>${(rings.sentences ?? []).map((one) => html`<p key=${one}>${one}</p>`)}
      <ul class="list">${rings.balls.map((one) => html`<li key=${one.id} class="ball-place"><span class="swatch"
        style=${{ background: one.colour }}></span>
        <strong>${one.name}</strong><span>${one.text}</span></li>`)}</ul></div>`}
  </div>`;
}
