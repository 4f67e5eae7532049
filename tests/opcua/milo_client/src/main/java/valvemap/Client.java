package valvemap;

import static org.eclipse.milo.opcua.stack.core.types.builtin.unsigned.Unsigned.uint;

import com.google.gson.JsonArray;
import com.google.gson.JsonElement;
import com.google.gson.JsonObject;
import com.google.gson.JsonParser;
import java.io.BufferedReader;
import java.io.InputStreamReader;
import java.io.PrintStream;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.HashMap;
import java.util.List;
import java.util.Map;
import java.util.concurrent.ExecutionException;
import org.eclipse.milo.opcua.sdk.client.OpcUaClient;
import org.eclipse.milo.opcua.sdk.client.subscriptions.OpcUaMonitoredItem;
import org.eclipse.milo.opcua.sdk.client.subscriptions.OpcUaSubscription;
import org.eclipse.milo.opcua.stack.core.AttributeId;
import org.eclipse.milo.opcua.stack.core.NodeIds;
import org.eclipse.milo.opcua.stack.core.StatusCodes;
import org.eclipse.milo.opcua.stack.core.UaException;
import org.eclipse.milo.opcua.stack.core.types.builtin.ByteString;
import org.eclipse.milo.opcua.stack.core.types.builtin.DataValue;
import org.eclipse.milo.opcua.stack.core.types.builtin.NodeId;
import org.eclipse.milo.opcua.stack.core.types.builtin.QualifiedName;
import org.eclipse.milo.opcua.stack.core.types.builtin.StatusCode;
import org.eclipse.milo.opcua.stack.core.types.builtin.Variant;
import org.eclipse.milo.opcua.stack.core.types.enumerated.BrowseDirection;
import org.eclipse.milo.opcua.stack.core.types.enumerated.DataChangeTrigger;
import org.eclipse.milo.opcua.stack.core.types.enumerated.TimestampsToReturn;
import org.eclipse.milo.opcua.stack.core.types.structured.BrowseDescription;
import org.eclipse.milo.opcua.stack.core.types.structured.BrowsePath;
import org.eclipse.milo.opcua.stack.core.types.structured.BrowsePathResult;
import org.eclipse.milo.opcua.stack.core.types.structured.BrowsePathTarget;
import org.eclipse.milo.opcua.stack.core.types.structured.BrowseResult;
import org.eclipse.milo.opcua.stack.core.types.structured.CallMethodRequest;
import org.eclipse.milo.opcua.stack.core.types.structured.CallMethodResult;
import org.eclipse.milo.opcua.stack.core.types.structured.DataChangeFilter;
import org.eclipse.milo.opcua.stack.core.types.structured.ReadValueId;
import org.eclipse.milo.opcua.stack.core.types.structured.ReferenceDescription;
import org.eclipse.milo.opcua.stack.core.types.structured.RelativePath;
import org.eclipse.milo.opcua.stack.core.types.structured.RelativePathElement;
import org.eclipse.milo.opcua.stack.core.types.structured.ViewDescription;
import org.eclipse.milo.opcua.stack.core.types.structured.WriteValue;

/** Eclipse Milo as a client; tests/support/peer.py says what it is told and what it answers. */
public final class Client {

  private static final class Connection {
    final OpcUaClient client;
    OpcUaSubscription subscription;
    List<JsonArray> changes = List.of();
    final Alarms alarms;

    /**
     * Keeps an idle subscription: without any, Milo is told Bad_NoSubscription, and where it hears
     * of that after the next subscription was made it never asks for anything again.
     */
    Connection(OpcUaClient client) throws UaException {
      this.client = client;
      alarms = new Alarms(client);
      new OpcUaSubscription(client, 1_000.0).create();
    }
  }

  private final Map<String, Connection> connections = new HashMap<>();

  public static void main(String[] arguments) throws Exception {
    PrintStream answers = new PrintStream(System.out, true, StandardCharsets.UTF_8);
    System.setOut(System.err);
    Client peer = new Client();
    BufferedReader steps =
        new BufferedReader(new InputStreamReader(System.in, StandardCharsets.UTF_8));
    for (String line = steps.readLine(); line != null; line = steps.readLine()) {
      answers.println(peer.answer(JsonParser.parseString(line).getAsJsonObject()));
    }
    System.exit(0);
  }

  private JsonObject answer(JsonObject step) {
    JsonObject answer = new JsonObject();
    try {
      answer.add("result", result(step));
    } catch (Exception error) {
      Throwable cause = error instanceof ExecutionException ? error.getCause() : error;
      answer.addProperty("error", String.valueOf(cause));
      UaException.extractStatusCode(cause)
          .ifPresent(code -> answer.addProperty("code", code.getValue()));
    }
    return answer;
  }

  private JsonElement result(JsonObject step) throws Exception {
    String name = Json.text(step, "as", "main");
    Connection connection = connections.get(name);
    switch (Json.text(step, "op", "")) {
      case "connect":
        connections.put(name, new Connection(Security.connect(step)));
        return new JsonObject();
      case "disconnect":
        connections.remove(name).client.disconnect();
        return new JsonObject();
      case "follow":
        return follow(connection.client, step);
      case "browse":
        return browse(connection.client, step);
      case "read":
        return read(connection.client, step);
      case "write":
        return write(connection.client, step);
      case "call":
        return call(connection.client, step);
      case "subscribe":
        return subscribe(connection, step);
      case "changes":
        return changes(connection);
      case "watchAlarms":
        return connection.alarms.watch();
      case "alarms":
        return connection.alarms.shown();
      case "act":
        return connection.alarms.act(step);
      case "walk":
        return Sweep.walk(connection.client, step);
      case "readEvery":
        return Sweep.readEvery(connection.client, step);
      case "history":
        return History.read(connection.client, id(connection.client, step, "node"), step);
      case "unsubscribe":
        connection.subscription.delete();
        return new JsonObject();
      default:
        throw new IllegalArgumentException(step.toString());
    }
  }

  private static JsonElement follow(OpcUaClient client, JsonObject step) throws UaException {
    List<RelativePathElement> elements = new ArrayList<>();
    for (JsonElement part : step.getAsJsonArray("path")) {
      String uri = part.getAsJsonArray().get(0).getAsString();
      String browseName = part.getAsJsonArray().get(1).getAsString();
      QualifiedName target =
          new QualifiedName(client.getNamespaceTable().getIndex(uri), browseName);
      elements.add(
          new RelativePathElement(NodeIds.HierarchicalReferences, false, true, target));
    }
    RelativePath path = new RelativePath(elements.toArray(new RelativePathElement[0]));
    BrowsePathResult found =
        client.translateBrowsePaths(List.of(new BrowsePath(id(client, step, "node"), path)))
            .getResults()[0];
    JsonArray targets = new JsonArray();
    if (found.getTargets() != null) {
      for (BrowsePathTarget target : found.getTargets()) {
        targets.add(String.valueOf(target.getTargetId().getIdentifier()));
      }
    }
    JsonObject result = coded(found.getStatusCode());
    result.add("targets", targets);
    return result;
  }

  private static JsonElement browse(OpcUaClient client, JsonObject step) throws UaException {
    BrowseDescription wanted =
        new BrowseDescription(
            id(client, step, "node"),
            BrowseDirection.Forward,
            NodeId.parse(Json.text(step, "reference", "i=33")),
            true,
            uint(0),
            uint(63));
    ViewDescription view = new ViewDescription(NodeId.NULL_VALUE, null, uint(0));
    int page = step.has("page") ? step.get("page").getAsInt() : 0;
    BrowseResult found = client.browse(view, uint(page), List.of(wanted)).getResults()[0];
    JsonArray names = new JsonArray();
    for (int pages = 1; ; pages++) {
      for (ReferenceDescription reference : found.getReferences()) {
        names.add(reference.getBrowseName().getName());
      }
      ByteString point = found.getContinuationPoint();
      if (point == null || point.isNullOrEmpty()) {
        JsonObject result = coded(found.getStatusCode());
        result.add("names", names);
        result.addProperty("pages", pages);
        return result;
      }
      found = client.browseNext(false, List.of(point)).getResults()[0];
    }
  }

  private static JsonElement read(OpcUaClient client, JsonObject step) throws UaException {
    AttributeId attribute = AttributeId.valueOf(Json.text(step, "attribute", "Value"));
    ReadValueId wanted =
        new ReadValueId(
            id(client, step, "node"),
            attribute.uid(),
            Json.text(step, "range", null),
            QualifiedName.NULL_VALUE);
    DataValue value =
        client.read(0.0, TimestampsToReturn.Both, List.of(wanted)).getResults()[0];
    return Json.shown(client, value);
  }

  private static JsonElement write(OpcUaClient client, JsonObject step) throws UaException {
    DataValue value = DataValue.valueOnly(Json.variant(step.getAsJsonObject("value")));
    WriteValue item =
        new WriteValue(id(client, step, "node"), AttributeId.Value.uid(), null, value);
    return coded(client.write(List.of(item)).getResults()[0]);
  }

  private static JsonElement call(OpcUaClient client, JsonObject step) throws UaException {
    List<Variant> inputs = new ArrayList<>();
    for (JsonElement input : step.getAsJsonArray("inputs")) {
      inputs.add(Json.variant(input.getAsJsonObject()));
    }
    CallMethodRequest request =
        new CallMethodRequest(
            id(client, step, "owner"), id(client, step, "method"), inputs.toArray(new Variant[0]));
    CallMethodResult found = client.call(List.of(request)).getResults()[0];
    JsonArray codes = new JsonArray();
    if (found.getInputArgumentResults() != null) {
      for (StatusCode code : found.getInputArgumentResults()) {
        codes.add(code.getValue());
      }
    }
    JsonArray outputs = new JsonArray();
    if (found.getOutputArguments() != null) {
      for (Variant output : found.getOutputArguments()) {
        outputs.add(Json.plain(client, output.getValue()));
      }
    }
    JsonObject result = coded(found.getStatusCode());
    result.add("inputs", codes);
    result.add("outputs", outputs);
    return result;
  }

  private static JsonElement subscribe(Connection connection, JsonObject step) throws UaException {
    OpcUaSubscription subscription =
        new OpcUaSubscription(connection.client, step.get("interval").getAsDouble());
    subscription.create();
    List<JsonArray> changes = new ArrayList<>();
    List<OpcUaMonitoredItem> items = new ArrayList<>();
    for (JsonElement wanted : step.getAsJsonArray("items")) {
      OpcUaMonitoredItem item = item(connection.client, wanted.getAsJsonObject());
      JsonArray seen = new JsonArray();
      item.setDataValueListener(
          (source, value) -> {
            synchronized (connection) {
              seen.add(Json.shown(connection.client, value));
            }
          });
      changes.add(seen);
      items.add(item);
    }
    connection.subscription = subscription;
    connection.changes = changes;
    subscription.addMonitoredItems(items);
    subscription.createMonitoredItems();
    JsonArray made = new JsonArray();
    for (OpcUaMonitoredItem item : items) {
      StatusCode code = item.getCreateResult().orElse(new StatusCode(StatusCodes.Bad_NoData));
      JsonObject one = coded(code);
      if (code.isGood()) {
        one.addProperty("queue", item.getRevisedQueueSize().orElseThrow());
        one.addProperty("sampling", item.getRevisedSamplingInterval().orElseThrow());
      }
      made.add(one);
    }
    JsonObject result = new JsonObject();
    result.addProperty("interval", subscription.getRevisedPublishingInterval().orElseThrow());
    result.add("items", made);
    return result;
  }

  private static OpcUaMonitoredItem item(OpcUaClient client, JsonObject wanted) {
    OpcUaMonitoredItem item = OpcUaMonitoredItem.newDataItem(id(client, wanted, "node"));
    item.setSamplingInterval(0.0);
    item.setQueueSize(uint(wanted.has("queue") ? wanted.get("queue").getAsInt() : 1000));
    JsonObject deadband = wanted.getAsJsonObject("deadband");
    int kind = deadband == null ? 0 : "Percent".equals(Json.text(deadband, "type", "")) ? 2 : 1;
    item.setFilter(
        new DataChangeFilter(
            DataChangeTrigger.valueOf(Json.text(wanted, "trigger", "StatusValue")),
            uint(kind),
            deadband == null ? 0.0 : deadband.get("value").getAsDouble()));
    return item;
  }

  private static JsonElement changes(Connection connection) {
    JsonArray taken = new JsonArray();
    synchronized (connection) {
      for (JsonArray seen : connection.changes) {
        taken.add(seen.deepCopy());
        while (!seen.isEmpty()) {
          seen.remove(seen.size() - 1);
        }
      }
    }
    return taken;
  }

  private static NodeId id(OpcUaClient client, JsonObject step, String field) {
    String text = step.get(field).getAsString();
    if (!text.startsWith("nsu=")) {
      return NodeId.parse(text);
    }
    int end = text.indexOf(';');
    return NodeId.parse(
        "ns=" + client.getNamespaceTable().getIndex(text.substring(4, end)) + text.substring(end));
  }

  static JsonObject coded(StatusCode code) {
    JsonObject result = new JsonObject();
    result.addProperty("code", code.getValue());
    return result;
  }

  private Client() {}
}
