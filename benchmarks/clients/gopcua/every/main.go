// Sweeps a server: gopcua as a client of tests/support/peer.py.
package main

import (
	"bufio"
	"context"
	"crypto/rsa"
	"crypto/x509"
	"encoding/json"
	"encoding/pem"
	"errors"
	"math"
	"os"
	"strconv"
	"time"

	"github.com/gopcua/opcua"
	"github.com/gopcua/opcua/id"
	"github.com/gopcua/opcua/ua"
)

const (
	longestLine   = 1 << 24
	browsedAtOnce = 100
)

type step struct {
	Op          string           `json:"op"`
	URL         string           `json:"url"`
	User        string           `json:"user"`
	Password    string           `json:"password"`
	Policy      string           `json:"policy"`
	Certificate string           `json:"certificate"`
	Key         string           `json:"key"`
	Nodes       []string         `json:"nodes"`
	Attributes  []uint32         `json:"attributes"`
	Root        string           `json:"root"`
	Reference   string           `json:"reference"`
	Owner       string           `json:"owner"`
	Method      string           `json:"method"`
	Inputs      []map[string]any `json:"inputs"`
	Node        string           `json:"node"`
	Start       int64            `json:"start"`
	End         int64            `json:"end"`
	Interval    float64          `json:"interval"`
	Aggregate   string           `json:"aggregate"`
}

type answer struct {
	Result any    `json:"result,omitempty"`
	Error  string `json:"error,omitempty"`
}

type counted struct {
	Codes  map[string]int    `json:"codes"`
	Faults []string          `json:"faults"`
	Types  map[string]string `json:"types"`
}

type shown struct {
	Value any    `json:"value"`
	Code  uint32 `json:"code"`
	Time  int64  `json:"time"`
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
		options, err := options(ctx, wanted)
		if err != nil {
			return nil, err
		}
		made, err := opcua.NewClient(wanted.URL, options...)
		if err == nil {
			client, err = made, made.Connect(ctx)
		}
		return true, err
	case "walk":
		return walk(ctx, wanted)
	case "readEvery":
		return readEvery(ctx, wanted)
	case "call":
		return call(ctx, wanted)
	case "history":
		return history(ctx, wanted)
	case "disconnect":
		return true, client.Close(ctx)
	}
	return nil, errors.New("unknown operation " + wanted.Op)
}

// options are those of an anonymous client without security, or of a user with both.
func options(ctx context.Context, wanted step) ([]opcua.Option, error) {
	if wanted.User == "" {
		return []opcua.Option{opcua.SecurityPolicy("None")}, nil
	}
	endpoints, err := opcua.GetEndpoints(ctx, wanted.URL)
	if err != nil {
		return nil, err
	}
	mode := ua.MessageSecurityModeSignAndEncrypt
	endpoint, err := opcua.SelectEndpoint(endpoints, wanted.Policy, mode)
	if err != nil {
		return nil, err
	}
	key, err := privateKey(wanted.Key)
	if err != nil {
		return nil, err
	}
	return []opcua.Option{
		opcua.CertificateFile(wanted.Certificate),
		opcua.PrivateKey(key),
		opcua.AuthUsername(wanted.User, wanted.Password),
		opcua.SecurityFromEndpoint(endpoint, ua.UserTokenTypeUserName),
	}, nil
}

func privateKey(file string) (*rsa.PrivateKey, error) {
	text, err := os.ReadFile(file)
	if err != nil {
		return nil, err
	}
	block, _ := pem.Decode(text)
	if block == nil {
		return nil, errors.New(file + ": no PEM")
	}
	if key, err := x509.ParsePKCS1PrivateKey(block.Bytes); err == nil {
		return key, nil
	}
	key, err := x509.ParsePKCS8PrivateKey(block.Bytes)
	if err != nil {
		return nil, err
	}
	ofRSA, ok := key.(*rsa.PrivateKey)
	if !ok {
		return nil, errors.New(file + ": not an RSA key")
	}
	return ofRSA, nil
}

// walk finds all nodes that references lead to, and the methods of objects among them.
func walk(ctx context.Context, wanted step) (any, error) {
	reference, err := ua.ParseNodeID(wanted.Reference)
	if err != nil {
		return nil, err
	}
	classes := map[string]ua.NodeClass{wanted.Root: ua.NodeClassObject}
	nodes, methods := []string{wanted.Root}, [][2]string{}
	for at := 0; at < len(nodes); {
		batch := nodes[at:min(at+browsedAtOnce, len(nodes))]
		at += len(batch)
		request := &ua.BrowseRequest{View: &ua.ViewDescription{ViewID: ua.NewTwoByteNodeID(0)}}
		for _, name := range batch {
			node, err := ua.ParseNodeID(name)
			if err != nil {
				return nil, err
			}
			request.NodesToBrowse = append(request.NodesToBrowse, &ua.BrowseDescription{
				NodeID:          node,
				BrowseDirection: ua.BrowseDirectionForward,
				ReferenceTypeID: reference,
				IncludeSubtypes: true,
				ResultMask:      uint32(ua.BrowseResultMaskAll),
			})
		}
		response, err := client.Browse(ctx, request)
		if err != nil {
			return nil, err
		}
		for k, result := range response.Results {
			if len(result.ContinuationPoint) > 0 {
				return nil, errors.New(batch[k] + ": more than a page")
			}
			for _, found := range result.References {
				name := found.NodeID.NodeID.String()
				if found.NodeClass == ua.NodeClassMethod && classes[batch[k]] == ua.NodeClassObject {
					methods = append(methods, [2]string{batch[k], name})
				}
				if _, known := classes[name]; !known {
					classes[name] = found.NodeClass
					nodes = append(nodes, name)
				}
			}
		}
	}
	return map[string]any{"nodes": nodes, "methods": methods}, nil
}

// readEvery reads all attributes of each node in a request: how many have which status, and the
// DataTypes.
func readEvery(ctx context.Context, wanted step) (any, error) {
	found := counted{Codes: map[string]int{}, Faults: []string{}, Types: map[string]string{}}
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
		for k, value := range response.Results {
			found.Codes[strconv.FormatUint(uint64(value.Status), 10)]++
			if ua.AttributeID(wanted.Attributes[k]) == ua.AttributeIDDataType && value.Status == ua.StatusOK {
				found.Types[name] = value.Value.NodeID().String()
			}
		}
	}
	return found, nil
}

func call(ctx context.Context, wanted step) (any, error) {
	owner, err := ua.ParseNodeID(wanted.Owner)
	if err != nil {
		return nil, err
	}
	method, err := ua.ParseNodeID(wanted.Method)
	if err != nil {
		return nil, err
	}
	request := &ua.CallMethodRequest{ObjectID: owner, MethodID: method}
	for _, input := range wanted.Inputs {
		variant, err := ua.NewVariant(input["value"])
		if err != nil {
			return nil, err
		}
		request.InputArguments = append(request.InputArguments, variant)
	}
	result, err := client.Call(ctx, request)
	if err != nil {
		return nil, err
	}
	return map[string]any{"code": uint32(result.StatusCode)}, nil
}

// history reads a processed past, all of it in one response.
func history(ctx context.Context, wanted step) (any, error) {
	node, err := ua.ParseNodeID(wanted.Node)
	if err != nil {
		return nil, err
	}
	aggregate, err := ua.ParseNodeID(wanted.Aggregate)
	if err != nil {
		return nil, err
	}
	details := &ua.ReadProcessedDetails{
		StartTime:              time.UnixMilli(wanted.Start).UTC(),
		EndTime:                time.UnixMilli(wanted.End).UTC(),
		ProcessingInterval:     wanted.Interval,
		AggregateType:          []*ua.NodeID{aggregate},
		AggregateConfiguration: &ua.AggregateConfiguration{UseServerCapabilitiesDefaults: true},
	}
	request := &ua.HistoryReadRequest{
		HistoryReadDetails: &ua.ExtensionObject{
			TypeID:       ua.NewFourByteExpandedNodeID(0, id.ReadProcessedDetails_Encoding_DefaultBinary),
			EncodingMask: ua.ExtensionObjectBinary,
			Value:        details,
		},
		TimestampsToReturn: ua.TimestampsToReturnBoth,
		NodesToRead:        []*ua.HistoryReadValueID{{NodeID: node, DataEncoding: &ua.QualifiedName{}}},
	}
	var response *ua.HistoryReadResponse
	err = client.Send(ctx, request, func(found ua.Response) error {
		read, is := found.(*ua.HistoryReadResponse)
		if !is {
			return errors.New("another response than that of HistoryRead")
		}
		response = read
		return nil
	})
	if err != nil {
		return nil, err
	}
	result, values := response.Results[0], []shown{}
	if result.HistoryData != nil && result.HistoryData.Value != nil {
		for _, value := range result.HistoryData.Value.(*ua.HistoryData).DataValues {
			values = append(values, shown{plain(value), uint32(value.Status), value.SourceTimestamp.UnixMilli()})
		}
	}
	return map[string]any{"code": uint32(result.StatusCode), "values": values}, nil
}

// plain returns a number, or null: JSON lacks NaN.
func plain(value *ua.DataValue) any {
	if value.Value == nil {
		return nil
	}
	if number, is := value.Value.Value().(float64); is && (math.IsNaN(number) || math.IsInf(number, 0)) {
		return nil
	}
	return value.Value.Value()
}
