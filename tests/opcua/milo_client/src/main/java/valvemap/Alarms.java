package valvemap;

import static org.eclipse.milo.opcua.stack.core.types.builtin.unsigned.Unsigned.uint;

import com.google.gson.JsonArray;
import com.google.gson.JsonElement;
import com.google.gson.JsonObject;
import java.util.ArrayList;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import org.eclipse.milo.opcua.sdk.client.OpcUaClient;
import org.eclipse.milo.opcua.sdk.client.subscriptions.OpcUaMonitoredItem;
import org.eclipse.milo.opcua.sdk.client.subscriptions.OpcUaSubscription;
import org.eclipse.milo.opcua.stack.core.AttributeId;
import org.eclipse.milo.opcua.stack.core.NodeIds;
import org.eclipse.milo.opcua.stack.core.UaException;
import org.eclipse.milo.opcua.stack.core.types.builtin.ExtensionObject;
import org.eclipse.milo.opcua.stack.core.types.builtin.LocalizedText;
import org.eclipse.milo.opcua.stack.core.types.builtin.NodeId;
import org.eclipse.milo.opcua.stack.core.types.builtin.QualifiedName;
import org.eclipse.milo.opcua.stack.core.types.builtin.StatusCode;
import org.eclipse.milo.opcua.stack.core.types.builtin.Variant;
import org.eclipse.milo.opcua.stack.core.types.enumerated.FilterOperator;
import org.eclipse.milo.opcua.stack.core.types.structured.CallMethodRequest;
import org.eclipse.milo.opcua.stack.core.types.structured.ContentFilter;
import org.eclipse.milo.opcua.stack.core.types.structured.ContentFilterElement;
import org.eclipse.milo.opcua.stack.core.types.structured.EventFilter;
import org.eclipse.milo.opcua.stack.core.types.structured.LiteralOperand;
import org.eclipse.milo.opcua.stack.core.types.structured.SimpleAttributeOperand;

/** A list of alarms that hears of every change, and acts on them. */
final class Alarms {

  /** What is shown of an alarm, and the event's field that says it. */
  private static final String[][] FIELDS = {
    {"name", "ConditionName"},
    {"source", "SourceName"},
    {"text", "Message"},
    {"active", "ActiveState/Id"},
    {"acked", "AckedState/Id"},
    {"confirmed", "ConfirmedState/Id"},
    {"retain", "Retain"},
    {"comment", "Comment"},
  };

  private static final Map<String, NodeId> METHODS =
      Map.of(
          "AddComment", NodeIds.ConditionType_AddComment,
          "Acknowledge", NodeIds.AcknowledgeableConditionType_Acknowledge,
          "Confirm", NodeIds.AcknowledgeableConditionType_Confirm);

  private final OpcUaClient client;
  private final Map<NodeId, Variant[]> newest = new LinkedHashMap<>();

  Alarms(OpcUaClient client) {
    this.client = client;
  }

  JsonElement watch() throws UaException {
    OpcUaSubscription subscription = new OpcUaSubscription(client, 50.0);
    subscription.create();
    OpcUaMonitoredItem item = OpcUaMonitoredItem.newEventItem(NodeIds.Server, filter());
    item.setQueueSize(uint(1000));
    item.setEventValueListener((source, values) -> take(values));
    subscription.addMonitoredItem(item);
    subscription.createMonitoredItems();
    Variant number = new Variant(subscription.getSubscriptionId().orElseThrow());
    return call(NodeIds.ConditionType, NodeIds.ConditionType_ConditionRefresh, number);
  }

  private synchronized void take(Variant[] values) {
    if (values[0].getValue() instanceof NodeId condition) { // none: a refresh begins or ends
      newest.put(condition, values);
    }
  }

  synchronized JsonElement shown() {
    JsonArray shown = new JsonArray();
    newest.forEach(
        (condition, values) -> {
          JsonObject one = new JsonObject();
          one.addProperty("condition", condition.toParseableString());
          for (int i = 0; i < FIELDS.length; i++) {
            one.add(FIELDS[i][0], Json.plain(client, values[i + 2].getValue()));
          }
          shown.add(one);
        });
    return shown;
  }

  JsonElement act(JsonObject step) throws UaException {
    NodeId condition = null;
    Variant event = null;
    synchronized (this) {
      for (Map.Entry<NodeId, Variant[]> each : newest.entrySet()) {
        if (step.get("name").getAsString().equals(each.getValue()[2].getValue())) {
          condition = each.getKey();
          event = each.getValue()[1];
        }
      }
    }
    Variant comment = new Variant(LocalizedText.english(step.get("comment").getAsString()));
    return call(condition, METHODS.get(step.get("method").getAsString()), event, comment);
  }

  private JsonElement call(NodeId owner, NodeId method, Variant... inputs) throws UaException {
    CallMethodRequest request = new CallMethodRequest(owner, method, inputs);
    StatusCode code = client.call(List.of(request)).getResults()[0].getStatusCode();
    return Client.coded(code);
  }

  private EventFilter filter() {
    List<SimpleAttributeOperand> clauses = new ArrayList<>();
    clauses.add(
        new SimpleAttributeOperand(
            NodeIds.ConditionType, new QualifiedName[0], AttributeId.NodeId.uid(), null));
    clauses.add(clause("EventId"));
    for (String[] field : FIELDS) {
      clauses.add(clause(field[1]));
    }
    ExtensionObject alarm =
        ExtensionObject.encode(
            client.getStaticEncodingContext(),
            new LiteralOperand(new Variant(NodeIds.AlarmConditionType)));
    ContentFilterElement ofType =
        new ContentFilterElement(FilterOperator.OfType, new ExtensionObject[] {alarm});
    return new EventFilter(
        clauses.toArray(new SimpleAttributeOperand[0]),
        new ContentFilter(new ContentFilterElement[] {ofType}));
  }

  private static SimpleAttributeOperand clause(String path) {
    String[] parts = path.split("/");
    QualifiedName[] names = new QualifiedName[parts.length];
    for (int i = 0; i < parts.length; i++) {
      names[i] = new QualifiedName(0, parts[i]);
    }
    return new SimpleAttributeOperand(
        NodeIds.BaseEventType, names, AttributeId.Value.uid(), null);
  }
}
