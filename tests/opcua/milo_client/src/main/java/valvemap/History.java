package valvemap;

import static org.eclipse.milo.opcua.stack.core.types.builtin.unsigned.Unsigned.ubyte;
import static org.eclipse.milo.opcua.stack.core.types.builtin.unsigned.Unsigned.uint;

import com.google.gson.JsonArray;
import com.google.gson.JsonElement;
import com.google.gson.JsonObject;
import java.time.Instant;
import java.util.List;
import org.eclipse.milo.opcua.sdk.client.OpcUaClient;
import org.eclipse.milo.opcua.stack.core.UaException;
import org.eclipse.milo.opcua.stack.core.types.builtin.ByteString;
import org.eclipse.milo.opcua.stack.core.types.builtin.DataValue;
import org.eclipse.milo.opcua.stack.core.types.builtin.DateTime;
import org.eclipse.milo.opcua.stack.core.types.builtin.NodeId;
import org.eclipse.milo.opcua.stack.core.types.builtin.QualifiedName;
import org.eclipse.milo.opcua.stack.core.types.enumerated.TimestampsToReturn;
import org.eclipse.milo.opcua.stack.core.types.structured.AggregateConfiguration;
import org.eclipse.milo.opcua.stack.core.types.structured.HistoryData;
import org.eclipse.milo.opcua.stack.core.types.structured.HistoryReadDetails;
import org.eclipse.milo.opcua.stack.core.types.structured.HistoryReadResult;
import org.eclipse.milo.opcua.stack.core.types.structured.HistoryReadValueId;
import org.eclipse.milo.opcua.stack.core.types.structured.ReadProcessedDetails;
import org.eclipse.milo.opcua.stack.core.types.structured.ReadRawModifiedDetails;

/** What a variable was, page by page. */
final class History {

  static JsonElement read(OpcUaClient client, NodeId node, JsonObject step) throws UaException {
    HistoryReadDetails details = details(step);
    JsonArray values = new JsonArray();
    ByteString point = ByteString.NULL_VALUE;
    for (int pages = 1; ; pages++) {
      HistoryReadValueId wanted =
          new HistoryReadValueId(node, null, QualifiedName.NULL_VALUE, point);
      HistoryReadResult found =
          client.historyRead(details, TimestampsToReturn.Both, false, List.of(wanted))
              .getResults()[0];
      if (found.getStatusCode().isGood()) {
        HistoryData data =
            (HistoryData) found.getHistoryData().decode(client.getStaticEncodingContext());
        for (DataValue value : data.getDataValues()) {
          values.add(Json.shown(client, value));
        }
      }
      point = found.getContinuationPoint();
      if (point == null || point.isNullOrEmpty()) {
        JsonObject result = Client.coded(found.getStatusCode());
        result.addProperty("pages", pages);
        result.add("values", values);
        return result;
      }
    }
  }

  private static HistoryReadDetails details(JsonObject step) {
    DateTime start = time(step, "start");
    DateTime end = time(step, "end");
    if (!step.has("aggregate")) {
      int page = step.has("page") ? step.get("page").getAsInt() : 0;
      return new ReadRawModifiedDetails(false, start, end, uint(page), false);
    }
    return new ReadProcessedDetails(
        start,
        end,
        step.get("interval").getAsDouble(),
        new NodeId[] {NodeId.parse(step.get("aggregate").getAsString())},
        new AggregateConfiguration(true, false, ubyte(0), ubyte(0), false));
  }

  private static DateTime time(JsonObject step, String field) {
    return new DateTime(Instant.ofEpochMilli(step.get(field).getAsLong()));
  }

  private History() {}
}
