package valvemap;

import com.google.gson.JsonArray;
import com.google.gson.JsonElement;
import com.google.gson.JsonNull;
import com.google.gson.JsonObject;
import com.google.gson.JsonPrimitive;
import java.lang.reflect.Array;
import java.lang.reflect.Method;
import org.eclipse.milo.opcua.sdk.client.OpcUaClient;
import org.eclipse.milo.opcua.stack.core.types.UaEnumeratedType;
import org.eclipse.milo.opcua.stack.core.types.builtin.DataValue;
import org.eclipse.milo.opcua.stack.core.types.builtin.ExpandedNodeId;
import org.eclipse.milo.opcua.stack.core.types.builtin.ExtensionObject;
import org.eclipse.milo.opcua.stack.core.types.builtin.LocalizedText;
import org.eclipse.milo.opcua.stack.core.types.builtin.Matrix;
import org.eclipse.milo.opcua.stack.core.types.builtin.QualifiedName;
import org.eclipse.milo.opcua.stack.core.types.builtin.Variant;
import org.eclipse.milo.opcua.stack.core.types.structured.Structure;

/** Values of OPC UA as JSON, and back. */
final class Json {

  static String text(JsonObject object, String field, String other) {
    JsonElement found = object.get(field);
    return found == null || found.isJsonNull() ? other : found.getAsString();
  }

  static Variant variant(JsonObject given) {
    JsonElement value = given.get("value");
    switch (given.get("type").getAsString()) {
      case "Boolean":
        return new Variant(value.getAsBoolean());
      case "Int32":
        return new Variant(value.getAsInt());
      case "Double":
        return new Variant(Double.valueOf(value.getAsString()));
      case "String":
        return new Variant(value.getAsString());
      default:
        throw new IllegalArgumentException(given.toString());
    }
  }

  static JsonObject shown(OpcUaClient client, DataValue value) {
    Object content = value.getValue().getValue();
    JsonElement dimensions = JsonNull.INSTANCE;
    if (content instanceof Matrix matrix) {
      dimensions = plain(client, matrix.getDimensions());
    }
    JsonObject shown = new JsonObject();
    shown.addProperty("type", value.getValue().getDataType().map(Enum::name).orElse("Null"));
    shown.add("dimensions", dimensions);
    shown.add("value", plain(client, content));
    shown.addProperty("code", value.getStatusCode().getValue());
    if (value.getSourceTime() != null) {
      shown.addProperty("time", value.getSourceTime().getJavaTime());
    }
    return shown;
  }

  static JsonElement plain(OpcUaClient client, Object value) {
    if (value == null) {
      return JsonNull.INSTANCE;
    }
    if (value instanceof Boolean flag) {
      return new JsonPrimitive(flag);
    }
    if (value instanceof Number number) {
      boolean isNumber = Double.isFinite(number.doubleValue());
      return isNumber ? new JsonPrimitive(number) : new JsonPrimitive(number.toString());
    }
    if (value instanceof Matrix matrix) {
      return plain(client, matrix.getElements());
    }
    if (value.getClass().isArray()) {
      JsonArray parts = new JsonArray();
      for (int i = 0; i < Array.getLength(value); i++) {
        parts.add(plain(client, Array.get(value, i)));
      }
      return parts;
    }
    if (value instanceof LocalizedText text) {
      return plain(client, text.getText());
    }
    if (value instanceof QualifiedName name) {
      return plain(client, name.getName());
    }
    if (value instanceof UaEnumeratedType enumerated) {
      return new JsonPrimitive(enumerated.getValue());
    }
    if (value instanceof ExtensionObject object) {
      return plain(client, object.decode(client.getStaticEncodingContext()));
    }
    if (value instanceof Structure structure) {
      return fields(client, structure);
    }
    return new JsonPrimitive(value.toString());
  }

  private static JsonObject fields(OpcUaClient client, Structure structure) {
    JsonObject fields = new JsonObject();
    for (Method method : structure.getClass().getDeclaredMethods()) {
      boolean isField =
          method.getName().startsWith("get")
              && method.getParameterCount() == 0
              && method.getReturnType() != ExpandedNodeId.class;
      if (isField) {
        String name = method.getName().substring(3);
        try {
          fields.add(
              Character.toLowerCase(name.charAt(0)) + name.substring(1),
              plain(client, method.invoke(structure)));
        } catch (ReflectiveOperationException error) {
          throw new IllegalStateException(error);
        }
      }
    }
    return fields;
  }

  private Json() {}
}
