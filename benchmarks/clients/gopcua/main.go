// Counts what a subscription brings: gopcua as a client of the rig, see ../README.md.
package main

import (
	"bufio"
	"context"
	"fmt"
	"log"
	"os"
	"strings"
	"sync/atomic"
	"time"

	"github.com/gopcua/opcua"
	"github.com/gopcua/opcua/ua"
)

const (
	publishingInterval = 100 * time.Millisecond
	reportInterval     = 200 * time.Millisecond
	notifications      = 100_000 // in a message, at most
	queue              = 1_000   // values
	itemsAtOnce        = 120
)

var received, lost atomic.Int64

func main() {
	ctx := context.Background()
	client, err := opcua.NewClient(os.Args[1], opcua.SecurityPolicy("None"))
	check(err)
	check(client.Connect(ctx))
	notified := make(chan *opcua.PublishNotificationData, 64)
	subscription, err := client.Subscribe(ctx, &opcua.SubscriptionParameters{
		Interval:                   publishingInterval,
		MaxNotificationsPerPublish: notifications,
	}, notified)
	check(err)
	names := lines()
	go count(notified, names)
	for first := 0; first < len(names); first += itemsAtOnce {
		watch(ctx, subscription, names, first, min(first+itemsAtOnce, len(names)))
	}
	for range time.Tick(reportInterval) {
		fmt.Println(received.Load(), lost.Load())
	}
}

func lines() []string {
	var found []string
	for scanner := bufio.NewScanner(os.Stdin); scanner.Scan(); {
		found = append(found, scanner.Text())
	}
	return found
}

func watch(ctx context.Context, subscription *opcua.Subscription, names []string, first, stop int) {
	var items []*ua.MonitoredItemCreateRequest
	for handle := first; handle < stop; handle++ {
		node, err := ua.ParseNodeID(names[handle])
		check(err)
		item := opcua.NewMonitoredItemCreateRequestWithDefaults(
			node, ua.AttributeIDValue, uint32(handle))
		item.RequestedParameters.QueueSize = queue
		item.RequestedParameters.Filter = ua.NewExtensionObject(
			&ua.DataChangeFilter{Trigger: ua.DataChangeTriggerStatusValueTimestamp})
		items = append(items, item)
	}
	made, err := subscription.Monitor(ctx, ua.TimestampsToReturnBoth, items...)
	check(err)
	for _, result := range made.Results {
		if result.StatusCode != ua.StatusOK {
			log.Fatal(result.StatusCode)
		}
	}
}

// count what comes, and what is missing between two running numbers of a valve.
func count(notified <-chan *opcua.PublishNotificationData, names []string) {
	numbers := make([]bool, len(names))
	for handle, name := range names {
		numbers[handle] = strings.HasSuffix(name, ".Sequence")
	}
	last := make([]uint32, len(names))
	for message := range notified {
		check(message.Error)
		changes, ok := message.Value.(*ua.DataChangeNotification)
		if !ok {
			continue
		}
		for _, item := range changes.MonitoredItems {
			if numbers[item.ClientHandle] {
				number := item.Value.Value.Value().(uint32)
				if before := last[item.ClientHandle]; before > 0 {
					lost.Add(int64(number) - int64(before) - 1)
				}
				last[item.ClientHandle] = number
			}
		}
		received.Add(int64(len(changes.MonitoredItems)))
	}
}

func check(err error) {
	if err != nil {
		log.Fatal(err)
	}
}
