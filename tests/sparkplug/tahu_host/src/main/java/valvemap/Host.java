package valvemap;

import com.google.gson.Gson;
import com.google.gson.GsonBuilder;
import com.google.gson.JsonObject;
import java.io.BufferedReader;
import java.io.InputStreamReader;
import java.util.Date;
import java.util.LinkedHashMap;
import java.util.List;
import java.util.Map;
import java.util.TreeMap;
import org.eclipse.tahu.host.HostApplication;
import org.eclipse.tahu.host.api.HostApplicationEventHandler;
import org.eclipse.tahu.host.manager.EdgeNodeManager;
import org.eclipse.tahu.host.model.HostApplicationMetricMap;
import org.eclipse.tahu.message.SparkplugBPayloadDecoder;
import org.eclipse.tahu.message.model.DeviceDescriptor;
import org.eclipse.tahu.message.model.EdgeNodeDescriptor;
import org.eclipse.tahu.message.model.Message;
import org.eclipse.tahu.message.model.MessageType;
import org.eclipse.tahu.message.model.Metric;
import org.eclipse.tahu.message.model.Metric.MetricBuilder;
import org.eclipse.tahu.message.model.MetricDataType;
import org.eclipse.tahu.message.model.PropertySet;
import org.eclipse.tahu.message.model.SparkplugBPayload.SparkplugBPayloadBuilder;
import org.eclipse.tahu.message.model.SparkplugDescriptor;
import org.eclipse.tahu.message.model.Template;
import org.eclipse.tahu.message.model.Topic;
import org.eclipse.tahu.model.MqttServerDefinition;
import org.eclipse.tahu.mqtt.MqttClientId;
import org.eclipse.tahu.mqtt.MqttServerName;
import org.eclipse.tahu.mqtt.MqttServerUrl;

/**
 * The host of Eclipse Tahu: writes what it made of births and data, one JSON object a line. A line
 * of JSON on standard input, {device, path, value}, is a command by the alias of a metric.
 */
public final class Host implements HostApplicationEventHandler {
  private static final Gson GSON =
      new GsonBuilder().serializeNulls().serializeSpecialFloatingPointValues().create();
  private static final HostApplicationMetricMap METRICS = HostApplicationMetricMap.getInstance();
  private static final EdgeNodeManager NODES = EdgeNodeManager.getInstance();

  /** Arguments: URL, group, edge node, host, user, password. */
  public static void main(String[] given) throws Exception {
    MqttServerDefinition broker =
        new MqttServerDefinition(
            new MqttServerName("broker"),
            new MqttClientId("tahu-" + given[3], false),
            new MqttServerUrl(given[0]),
            given[4],
            given[5],
            30,
            null);
    HostApplication host =
        new HostApplication(
            new Host(),
            given[3],
            List.of("spBv1.0/" + given[1] + "/#"),
            List.of(broker),
            null,
            new SparkplugBPayloadDecoder(),
            true);
    host.start(true);
    EdgeNodeDescriptor node = new EdgeNodeDescriptor(given[1], given[2]);
    BufferedReader lines = new BufferedReader(new InputStreamReader(System.in));
    for (String line = lines.readLine(); line != null; line = lines.readLine()) {
      JsonObject asked = GSON.fromJson(line, JsonObject.class);
      command(host, node, asked);
    }
    System.exit(0);
  }

  private static void command(HostApplication host, EdgeNodeDescriptor node, JsonObject asked)
      throws Exception {
    DeviceDescriptor device = new DeviceDescriptor(node, asked.get("device").getAsString());
    String path = asked.get("path").getAsString();
    MetricDataType type = METRICS.getDataType(node, device, path);
    Object value =
        type == MetricDataType.Double
            ? asked.get("value").getAsDouble()
            : asked.get("value").getAsString();
    Metric metric =
        new MetricBuilder(METRICS.getAlias(node, device, path), type, value).createMetric();
    host.publishCommand(
        new Topic(
            "spBv1.0",
            node.getGroupId(),
            node.getEdgeNodeId(),
            device.getDeviceId(),
            MessageType.DCMD),
        new SparkplugBPayloadBuilder().setTimestamp(new Date()).addMetric(metric).createPayload());
  }

  @Override
  public void onNodeBirthComplete(EdgeNodeDescriptor node) {
    Map<String, Object> told = told("NBIRTH", node);
    told.put("metrics", described(NODES.getSparkplugEdgeNode(node).getMetricMap(), ""));
    write(told);
  }

  /** The device as it was built from the births alone: each instance by its definition. */
  @Override
  public void onDeviceBirthComplete(DeviceDescriptor device) {
    EdgeNodeDescriptor node = device.getEdgeNodeDescriptor();
    Map<String, Object> told = told("DBIRTH", device);
    Map<String, Object> metrics = new TreeMap<>();
    NODES
        .getSparkplugDevice(node, device)
        .getMetricMap()
        .forEach((name, metric) -> metrics.put(name, built(node, metric)));
    told.put("metrics", metrics);
    write(told);
  }

  private static Map<String, Object> built(EdgeNodeDescriptor node, Metric metric) {
    if (!(metric.getValue() instanceof Template instance)) {
      return described(metric);
    }
    Map<String, Object> told = new LinkedHashMap<>();
    Metric definition = NODES.getSparkplugEdgeNode(node).getMetric(instance.getTemplateRef());
    Map<String, Object> members = new TreeMap<>();
    Map<String, Metric> given = new LinkedHashMap<>();
    instance.getMetrics().forEach(member -> given.put(member.getName(), member));
    for (Metric declared : ((Template) definition.getValue()).getMetrics()) {
      Map<String, Object> member = described(declared);
      member.putAll(described(given.remove(declared.getName())));
      members.put(declared.getName(), member);
    }
    told.put("template", instance.getTemplateRef());
    told.put("isDefinition", instance.isDefinition());
    told.put("members", members);
    told.put("undeclared", given.keySet());
    return told;
  }

  private static Map<String, Object> described(Map<String, ? extends Metric> metrics, String path) {
    Map<String, Object> told = new TreeMap<>();
    metrics.forEach((name, metric) -> told.put(path + name, described(metric)));
    return told;
  }

  /** Type, value and properties of a metric; properties that it lacks are left out. */
  private static Map<String, Object> described(Metric metric) {
    Map<String, Object> told = new LinkedHashMap<>();
    told.put("type", metric.getDataType().toString());
    if (metric.getValue() instanceof Template template) {
      told.put("isDefinition", template.isDefinition());
      told.put("ref", template.getTemplateRef());
      told.put("members", template.getMetrics().size());
      return told;
    }
    told.put("value", plain(metric.getValue()));
    PropertySet properties = metric.getProperties();
    if (properties != null) {
      properties.getPropertyMap().forEach((key, value) -> told.put(key, plain(value.getValue())));
    }
    return told;
  }

  @Override
  public void onDataMetric(SparkplugDescriptor from, Metric metric) {
    Map<String, Object> told = told("DATA", from);
    Map<String, Object> metrics = new LinkedHashMap<>();
    if (metric.getValue() instanceof Template instance) {
      DeviceDescriptor device = (DeviceDescriptor) from;
      for (Metric member : instance.getMetrics()) {
        String name =
            METRICS.getMetricName(device.getEdgeNodeDescriptor(), device, member.getAlias());
        metrics.put(String.valueOf(name), plain(member.getValue()));
      }
    } else {
      metrics.put(String.valueOf(metric.getName()), plain(metric.getValue()));
    }
    told.put("metrics", metrics);
    write(told);
  }

  private static Object plain(Object value) {
    return value instanceof Date time ? (Object) time.getTime() : value;
  }

  private static Map<String, Object> told(String verb, SparkplugDescriptor from) {
    Map<String, Object> told = new LinkedHashMap<>();
    told.put("verb", verb);
    told.put("device", from instanceof DeviceDescriptor device ? device.getDeviceId() : null);
    return told;
  }

  private static synchronized void write(Object told) {
    System.out.println(GSON.toJson(told));
  }

  @Override
  public void onConnect() {
    write(Map.of("verb", "CONNECTED"));
  }

  @Override
  public void onDisconnect() {}

  @Override
  public void onMessage(SparkplugDescriptor from, Message message) {}

  @Override
  public void onNodeBirthArrived(EdgeNodeDescriptor node, Message message) {}

  @Override
  public void onNodeDataArrived(EdgeNodeDescriptor node, Message message) {}

  @Override
  public void onNodeDataComplete(EdgeNodeDescriptor node) {}

  @Override
  public void onNodeDeath(EdgeNodeDescriptor node, Message message) {}

  @Override
  public void onNodeDeathComplete(EdgeNodeDescriptor node) {}

  @Override
  public void onDeviceBirthArrived(DeviceDescriptor device, Message message) {}

  @Override
  public void onDeviceDataArrived(DeviceDescriptor device, Message message) {}

  @Override
  public void onDeviceDataComplete(DeviceDescriptor device) {}

  @Override
  public void onDeviceDeath(DeviceDescriptor device, Message message) {}

  @Override
  public void onDeviceDeathComplete(DeviceDescriptor device) {}

  @Override
  public void onBirthMetric(SparkplugDescriptor from, Metric metric) {}

  @Override
  public void onStale(SparkplugDescriptor from, Metric metric) {}
}
