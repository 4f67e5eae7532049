// node-opcua's own aggregates. A line of JSON on the standard input asks for one:
// {aggregate, past: [[ms, value, code]], start, end, width, stepped, rules}; a line answers it with
// [[ms, value or null, code]].
const { createInterface } = require("node:readline");
const aggregates = require("node-opcua-aggregates");
const { NodeClass } = require("node-opcua-data-model");
const { DataValue } = require("node-opcua-data-value");
const { coerceStatusCode } = require("node-opcua-status-code");

const FUNCTIONS = {
  AVERAGE: aggregates.getAverageData,
  COUNT: aggregates.getCountData,
  DURATION_BAD: aggregates.getDurationBadData,
  DURATION_GOOD: aggregates.getDurationGoodData,
  INTERPOLATIVE: aggregates.getInterpolatedData,
  MAXIMUM: aggregates.getMaxData,
  MINIMUM: aggregates.getMinData,
  PERCENT_BAD: aggregates.getPercentBadData,
  PERCENT_GOOD: aggregates.getPercentGoodData,
};

const held = (value) => ({ readValue: () => ({ value: { value } }) });

// As much of a variable as the aggregates ask for.
function variable({ past, stepped, rules }) {
  const dataValues = past.map(
    ([ms, value, code]) =>
      new DataValue({
        sourceTimestamp: new Date(ms),
        statusCode: coerceStatusCode(code),
        value: { dataType: "Double", value },
      }),
  );
  return {
    nodeClass: NodeClass.Variable,
    historyRead: (_context, _details, _range, _encoding, _point, answer) =>
      answer(null, { historyData: { dataValues } }),
    $historicalDataConfiguration: {
      stepped: held(stepped),
      aggregateConfiguration: {
        percentDataBad: held(rules.percentBad),
        percentDataGood: held(rules.percentGood),
        treatUncertainAsBad: held(rules.treatUncertainAsBad),
        useSlopedExtrapolation: held(rules.sloped),
      },
    },
  };
}

createInterface({ input: process.stdin }).on("line", (line) => {
  const asked = JSON.parse(line);
  const [start, end] = [new Date(asked.start), new Date(asked.end)];
  FUNCTIONS[asked.aggregate](variable(asked), asked.width, start, end, (error, found) => {
    const answer = error
      ? { error: String(error) }
      : found.map((v) => [v.sourceTimestamp.getTime(), v.value?.value ?? null, v.statusCode.value]);
    process.stdout.write(`${JSON.stringify(answer)}\n`);
  });
});
