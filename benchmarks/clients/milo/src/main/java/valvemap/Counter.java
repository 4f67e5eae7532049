package valvemap;

import static org.eclipse.milo.opcua.stack.core.types.builtin.unsigned.Unsigned.uint;

import java.io.BufferedReader;
import java.io.InputStreamReader;
import java.nio.charset.StandardCharsets;
import java.util.ArrayList;
import java.util.IdentityHashMap;
import java.util.List;
import java.util.Map;
import java.util.concurrent.atomic.AtomicLong;
import org.eclipse.milo.opcua.sdk.client.OpcUaClient;
import org.eclipse.milo.opcua.sdk.client.subscriptions.MonitoredItemServiceOperationResult;
import org.eclipse.milo.opcua.sdk.client.subscriptions.OpcUaMonitoredItem;
import org.eclipse.milo.opcua.sdk.client.subscriptions.OpcUaSubscription;
import org.eclipse.milo.opcua.stack.core.channel.EncodingLimits;
import org.eclipse.milo.opcua.stack.core.security.SecurityPolicy;
import org.eclipse.milo.opcua.stack.core.types.builtin.DataValue;
import org.eclipse.milo.opcua.stack.core.types.builtin.NodeId;
import org.eclipse.milo.opcua.stack.core.types.builtin.unsigned.UInteger;
import org.eclipse.milo.opcua.stack.core.types.enumerated.DataChangeTrigger;
import org.eclipse.milo.opcua.stack.core.types.structured.DataChangeFilter;

/** Counts what a subscription brings: Eclipse Milo as a client of the rig, see ../README.md. */
public final class Counter {

  private static final double PUBLISHING_INTERVAL_MS = 100.0;
  private static final long REPORT_INTERVAL_MS = 200;
  private static final int NOTIFICATIONS = 100_000; // in a message, at most
  private static final int QUEUE = 1_000; // values
  private static final int ITEMS_AT_ONCE = 120;
  private static final int LARGEST = 64 << 20; // bytes of a message

  private static final AtomicLong received = new AtomicLong();
  private static final AtomicLong lost = new AtomicLong();

  public static void main(String[] arguments) throws Exception {
    List<String> names =
        new BufferedReader(new InputStreamReader(System.in, StandardCharsets.UTF_8))
            .lines()
            .toList();
    OpcUaClient client =
        OpcUaClient.create(
            arguments[0],
            endpoints ->
                endpoints.stream()
                    .filter(e -> e.getSecurityPolicyUri().equals(SecurityPolicy.None.getUri()))
                    .findFirst(),
            transport -> {},
            config ->
                config.setEncodingLimits(
                    new EncodingLimits(65_536, LARGEST / 65_536, LARGEST, 128)));
    client.connect();
    OpcUaSubscription subscription = new OpcUaSubscription(client, PUBLISHING_INTERVAL_MS);
    subscription.setMaxNotificationsPerPublish(uint(NOTIFICATIONS));
    subscription.setMaxMonitoredItemsPerCall(uint(ITEMS_AT_ONCE));
    List<OpcUaMonitoredItem> items = new ArrayList<>();
    Map<OpcUaMonitoredItem, Long> numbers = new IdentityHashMap<>();
    for (String name : names) {
      OpcUaMonitoredItem item = item(name);
      items.add(item);
      if (name.endsWith(".Sequence")) {
        numbers.put(item, 0L);
      }
    }
    subscription.setSubscriptionListener(
        new OpcUaSubscription.SubscriptionListener() {
          @Override
          public void onDataReceived(
              OpcUaSubscription of, List<OpcUaMonitoredItem> changed, List<DataValue> values) {
            for (int k = 0; k < changed.size(); k++) {
              OpcUaMonitoredItem item = changed.get(k);
              Long before = numbers.get(item);
              if (before != null) {
                long number = ((UInteger) values.get(k).value().value()).longValue();
                if (before > 0) {
                  lost.addAndGet(number - before - 1);
                }
                numbers.put(item, number);
              }
            }
            received.addAndGet(changed.size());
          }
        });
    subscription.create();
    subscription.addMonitoredItems(items);
    for (MonitoredItemServiceOperationResult made : subscription.createMonitoredItems()) {
      if (!made.isGood()) {
        throw new IllegalStateException(made.toString());
      }
    }
    while (true) {
      System.out.println(received + " " + lost);
      Thread.sleep(REPORT_INTERVAL_MS);
    }
  }

  /** Every sample of a node: a constant one too, so the trigger looks at the timestamp. */
  private static OpcUaMonitoredItem item(String name) {
    OpcUaMonitoredItem item = OpcUaMonitoredItem.newDataItem(NodeId.parse(name));
    item.setSamplingInterval(0.0);
    item.setQueueSize(uint(QUEUE));
    item.setFilter(
        new DataChangeFilter(DataChangeTrigger.StatusValueTimestamp, uint(0), 0.0));
    return item;
  }

  private Counter() {}
}
