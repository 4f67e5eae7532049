// Reads every attribute of nodes: gopcua as a client of tests/support/peer.py.
package main

import (
	"bufio"
	"context"
	"encoding/json"
	"errors"
	"os"
	"strconv"

	"github.com/gopcua/opcua"
	"github.com/gopcua/opcua/ua"
)

const longestLine = 1 << 24

type step struct {
	Op         string   `json:"op"`
	URL        string   `json:"url"`
	Nodes      []string `json:"nodes"`
	Attributes []uint32 `json:"attributes"`
}

type answer struct {
	Result any    `json:"result,omitempty"`
	Error  string `json:"error,omitempty"`
}

type counted struct {
	Codes  map[string]int `json:"codes"`
	Faults []string       `json:"faults"`
}

var client *opcua.Client

func main() {
	scanner := bufio.NewScanner(os.Stdin)
	scanner.Buffer(nil, longestLine)
	out := json.NewEncoder(os.Stdout)
	for scanner.Scan() {
		var wanted step
		result, err := any(nil), json.Unmarshal(scanner.Bytes(), &wanted)
		if err == nil {
			result, err = do(context.Background(), wanted)
		}
		if err != nil {
			out.Encode(answer{Error: err.Error()})
			continue
		}
		out.Encode(answer{Result: result})
	}
}

func do(ctx context.Context, wanted step) (any, error) {
	switch wanted.Op {
	case "connect":
		made, err := opcua.NewClient(wanted.URL, opcua.SecurityPolicy("None"))
		if err == nil {
			client, err = made, made.Connect(ctx)
		}
		return true, err
	case "readEvery":
		return readEvery(ctx, wanted)
	case "disconnect":
		return true, client.Close(ctx)
	}
	return nil, errors.New("unknown operation " + wanted.Op)
}

// readEvery reads all attributes of each node in a request: how many have which status.
func readEvery(ctx context.Context, wanted step) (any, error) {
	found := counted{Codes: map[string]int{}, Faults: []string{}}
	for _, name := range wanted.Nodes {
		node, err := ua.ParseNodeID(name)
		if err != nil {
			return nil, err
		}
		request := &ua.ReadRequest{TimestampsToReturn: ua.TimestampsToReturnBoth}
		for _, attribute := range wanted.Attributes {
			request.NodesToRead = append(request.NodesToRead,
				&ua.ReadValueID{NodeID: node, AttributeID: ua.AttributeID(attribute)})
		}
		response, err := client.Read(ctx, request)
		if err != nil {
			found.Faults = append(found.Faults, name+": "+err.Error())
			continue
		}
		for _, value := range response.Results {
			found.Codes[strconv.FormatUint(uint64(value.Status), 10)]++
		}
	}
	return found, nil
}
