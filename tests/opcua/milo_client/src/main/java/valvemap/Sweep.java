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
import org.eclipse.milo.opcua.stack.core.AttributeId;
import org.eclipse.milo.opcua.stack.core.UaException;
import org.eclipse.milo.opcua.stack.core.types.builtin.DataValue;
import org.eclipse.milo.opcua.stack.core.types.builtin.NodeId;
import org.eclipse.milo.opcua.stack.core.types.builtin.QualifiedName;
import org.eclipse.milo.opcua.stack.core.types.enumerated.BrowseDirection;
import org.eclipse.milo.opcua.stack.core.types.enumerated.NodeClass;
import org.eclipse.milo.opcua.stack.core.types.enumerated.TimestampsToReturn;
import org.eclipse.milo.opcua.stack.core.types.structured.BrowseDescription;
import org.eclipse.milo.opcua.stack.core.types.structured.BrowseResult;
import org.eclipse.milo.opcua.stack.core.types.structured.ReadValueId;
import org.eclipse.milo.opcua.stack.core.types.structured.ReferenceDescription;
import org.eclipse.milo.opcua.stack.core.types.structured.ViewDescription;

/** All nodes and all attributes. */
final class Sweep {

  private static final int BROWSED_AT_ONCE = 100;

  /** All nodes that references lead to, and the methods of objects among them. */
  static JsonElement walk(OpcUaClient client, JsonObject step) throws UaException {
    NodeId reference = NodeId.parse(step.get("reference").getAsString());
    Map<String, NodeClass> classes = new LinkedHashMap<>();
    classes.put(step.get("root").getAsString(), NodeClass.Object);
    List<String> nodes = new ArrayList<>(classes.keySet());
    JsonArray methods = new JsonArray();
    for (int at = 0; at < nodes.size(); ) {
      List<String> batch =
          List.copyOf(nodes.subList(at, Math.min(at + BROWSED_AT_ONCE, nodes.size())));
      at += batch.size();
      BrowseResult[] results = browse(client, batch, reference);
      for (int k = 0; k < results.length; k++) {
        if (results[k].getContinuationPoint() != null
            && results[k].getContinuationPoint().isNotNull()
            && results[k].getContinuationPoint().length() > 0) {
          throw new IllegalStateException(batch.get(k) + ": more than a page");
        }
        if (results[k].getReferences() == null) {
          continue;
        }
        for (ReferenceDescription found : results[k].getReferences()) {
          String id =
              found.getNodeId().toNodeIdOrThrow(client.getNamespaceTable()).toParseableString();
          if (found.getNodeClass() == NodeClass.Method
              && classes.get(batch.get(k)) == NodeClass.Object) {
            JsonArray pair = new JsonArray();
            pair.add(batch.get(k));
            pair.add(id);
            methods.add(pair);
          }
          if (classes.putIfAbsent(id, found.getNodeClass()) == null) {
            nodes.add(id);
          }
        }
      }
    }
    JsonArray every = new JsonArray();
    nodes.forEach(every::add);
    JsonObject result = new JsonObject();
    result.add("nodes", every);
    result.add("methods", methods);
    return result;
  }

  private static BrowseResult[] browse(OpcUaClient client, List<String> batch, NodeId reference)
      throws UaException {
    List<BrowseDescription> wanted = new ArrayList<>();
    for (String id : batch) {
      wanted.add(
          new BrowseDescription(
              NodeId.parse(id), BrowseDirection.Forward, reference, true, uint(0), uint(63)));
    }
    ViewDescription view = new ViewDescription(NodeId.NULL_VALUE, null, uint(0));
    return client.browse(view, uint(0), wanted).getResults();
  }

  /**
   * All attributes of each node in a request: how many have which status, which are refused, and
   * the DataTypes.
   */
  static JsonElement readEvery(OpcUaClient client, JsonObject step) {
    Map<String, Integer> codes = new LinkedHashMap<>();
    JsonArray faults = new JsonArray();
    JsonObject types = new JsonObject();
    for (JsonElement node : step.getAsJsonArray("nodes")) {
      List<ReadValueId> wanted = new ArrayList<>();
      for (JsonElement attribute : step.getAsJsonArray("attributes")) {
        wanted.add(
            new ReadValueId(
                NodeId.parse(node.getAsString()),
                uint(attribute.getAsInt()),
                null,
                QualifiedName.NULL_VALUE));
      }
      try {
        DataValue[] found = client.read(0.0, TimestampsToReturn.Both, wanted).getResults();
        for (int k = 0; k < found.length; k++) {
          codes.merge(String.valueOf(found[k].getStatusCode().getValue()), 1, Integer::sum);
          boolean isType = wanted.get(k).getAttributeId().equals(AttributeId.DataType.uid());
          if (isType && found[k].getValue().getValue() instanceof NodeId type) {
            types.addProperty(node.getAsString(), type.toParseableString());
          }
        }
      } catch (UaException error) {
        faults.add(node.getAsString() + ": " + error.getMessage());
      }
    }
    JsonObject counted = new JsonObject();
    codes.forEach(counted::addProperty);
    JsonObject result = new JsonObject();
    result.add("codes", counted);
    result.add("faults", faults);
    result.add("types", types);
    return result;
  }

  private Sweep() {}
}
