// Times as the browser's own zone has them.

const IN_TEXT = /(\d{4}-\d\d-\d\d) (\d\d:\d\d:\d\d) UTC/g;

/** Time of day; with the date if that is another one. */
export function clock(ms) {
  if (!ms) return "–";
  const date = new Date(ms);
  const time = date.toLocaleTimeString("en-GB");
  return date.toDateString() === new Date().toDateString() ? time : `${date.toLocaleDateString("en-GB")} ${time}`;
}

/** A sentence of the service, with its times as all others are shown. */
export const inLocalTime = (text) => text.replace(IN_TEXT, (_, day, time) => clock(Date.parse(`${day}T${time}Z`)));
