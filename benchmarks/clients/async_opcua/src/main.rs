//! Counts what a subscription brings: async-opcua as a client of the rig, see ../../README.md.

use std::io::{read_to_string, stdin};
use std::str::FromStr;
use std::sync::atomic::{AtomicI64, Ordering::Relaxed};
use std::time::Duration;

use opcua_client::{ClientBuilder, DataChangeCallback, IdentityToken, MonitoredItem};
use opcua_types::{
    DataChangeFilter, DataChangeTrigger, DataValue, ExtensionObject, MessageSecurityMode,
    MonitoredItemCreateRequest, MonitoringMode, MonitoringParameters, NodeId, ReadValueId,
    TimestampsToReturn, UserTokenPolicy, Variant,
};

const PUBLISHING_INTERVAL: Duration = Duration::from_millis(100);
const REPORT_INTERVAL: Duration = Duration::from_millis(200);
const KEEP_ALIVES: u32 = 30; // publishing intervals
const LIFETIME: u32 = 10 * KEEP_ALIVES;
const NOTIFICATIONS: u32 = 100_000; // in a message, at most
const MOST: usize = 1_000_000; // of an array
const QUEUE: u32 = 1_000; // values
const ITEMS_AT_ONCE: usize = 120;

static RECEIVED: AtomicI64 = AtomicI64::new(0);
static LOST: AtomicI64 = AtomicI64::new(0);

#[tokio::main]
async fn main() {
    let url = std::env::args().nth(1).expect("a URL");
    let names: Vec<String> = read_to_string(stdin())
        .expect("node ids")
        .lines()
        .map(String::from)
        .collect();
    let mut client = ClientBuilder::new()
        .application_name("valvemap-async-opcua")
        .application_uri("urn:valvemap:async-opcua")
        .create_sample_keypair(false)
        .max_array_length(MOST)
        .max_message_size(0)
        .max_chunk_count(0)
        .client()
        .expect("a client");
    let endpoint = (
        url.as_str(),
        "None",
        MessageSecurityMode::None,
        UserTokenPolicy::anonymous(),
    );
    let (session, event_loop) = client
        .connect_to_matching_endpoint(endpoint, IdentityToken::Anonymous)
        .await
        .expect("a session");
    event_loop.spawn();
    session.wait_for_connection().await;
    let numbers: Vec<bool> = names.iter().map(|n| n.ends_with(".Sequence")).collect();
    let mut last = vec![0u32; names.len()];
    let count = move |value: DataValue, item: &MonitoredItem| {
        let handle = item.client_handle() as usize - 1;
        if numbers[handle] {
            if let Some(Variant::UInt32(number)) = value.value {
                if last[handle] > 0 {
                    LOST.fetch_add(i64::from(number) - i64::from(last[handle]) - 1, Relaxed);
                }
                last[handle] = number;
            }
        }
        RECEIVED.fetch_add(1, Relaxed);
    };
    let subscription = session
        .create_subscription(
            PUBLISHING_INTERVAL,
            LIFETIME,
            KEEP_ALIVES,
            NOTIFICATIONS,
            0,
            true,
            DataChangeCallback::new(count),
        )
        .await
        .expect("a subscription");
    for (part, chunk) in names.chunks(ITEMS_AT_ONCE).enumerate() {
        let wanted = chunk
            .iter()
            .enumerate()
            .map(|(k, name)| item(name, (part * ITEMS_AT_ONCE + k + 1) as u32))
            .collect();
        let made = session
            .create_monitored_items(subscription, TimestampsToReturn::Both, wanted)
            .await
            .expect("monitored items");
        for one in made {
            assert!(one.result.status_code.is_good(), "{:?}", one.result);
        }
    }
    loop {
        println!("{} {}", RECEIVED.load(Relaxed), LOST.load(Relaxed));
        tokio::time::sleep(REPORT_INTERVAL).await;
    }
}

/// Every sample of a node: a constant one too, so the trigger looks at the timestamp.
fn item(name: &str, client_handle: u32) -> MonitoredItemCreateRequest {
    let filter = DataChangeFilter {
        trigger: DataChangeTrigger::StatusValueTimestamp,
        deadband_type: 0,
        deadband_value: 0.0,
    };
    MonitoredItemCreateRequest {
        item_to_monitor: ReadValueId::from(NodeId::from_str(name).expect("a node id")),
        monitoring_mode: MonitoringMode::Reporting,
        requested_parameters: MonitoringParameters {
            client_handle,
            sampling_interval: 0.0,
            filter: ExtensionObject::from_message(filter),
            queue_size: QUEUE,
            discard_oldest: true,
        },
    }
}
