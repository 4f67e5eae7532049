"""C99 of an FMI 2.0 co-simulation unit: the calls of the standard around the tables' functions."""

from typing import Final

FMI_TYPES: Final = r"""
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define VALVEMAP_EXPORT __declspec(dllexport)
#else
#define VALVEMAP_EXPORT __attribute__((visibility("default")))
#endif

/* Types of FMI 2.0, as its headers declare them. */
typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
    fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated
} fmi2StatusKind;
typedef struct fmi2CallbackFunctions fmi2CallbackFunctions;
"""

FMI_CALLS: Final = r"""
typedef struct {
    double input[3];   /* U, Q_demand, dp */
    double real[6];    /* Q, Q_lower, Q_upper, U_required, U_lower, U_upper */
    int status[2];     /* Q_status, U_status */
    double time;
} Valve;

static const double constants[3] = {
    VALVEMAP_ERROR_FLOW, VALVEMAP_ERROR_U, VALVEMAP_ERROR_Q
};

static void start(Valve *valve)
{
    memset(valve, 0, sizeof *valve);
    valve->input[2] = VALVEMAP_DP_START;
}

static void evaluate(Valve *valve)
{
    double *out = valve->real;
    valve->status[0] = valvemap_flow(valve->input[0], valve->input[2], out, out + 1, out + 2);
    valve->status[1] = valvemap_required_U(valve->input[1], valve->input[2], out + 3);
    valvemap_U_interval(valve->input[1], valve->input[2], valve->status[1], out[3], out + 4);
}

VALVEMAP_EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
VALVEMAP_EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

VALVEMAP_EXPORT fmi2Status fmi2SetDebugLogging(
    fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c; (void)on; (void)n; (void)categories;
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Component fmi2Instantiate(
    fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    Valve *valve;
    (void)name; (void)resources; (void)functions; (void)visible; (void)logging;
    if (type != fmi2CoSimulation || guid == NULL || strcmp(guid, VALVEMAP_GUID) != 0)
        return NULL;
    valve = malloc(sizeof *valve);
    if (valve != NULL)
        start(valve);
    return valve;
}

VALVEMAP_EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }

VALVEMAP_EXPORT fmi2Status fmi2SetupExperiment(
    fmi2Component c, fmi2Boolean hasTolerance, fmi2Real tolerance, fmi2Real startTime,
    fmi2Boolean hasStop, fmi2Real stopTime)
{
    (void)hasTolerance; (void)tolerance; (void)hasStop; (void)stopTime;
    ((Valve *)c)->time = startTime;
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
VALVEMAP_EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) { (void)c; return fmi2OK; }
VALVEMAP_EXPORT fmi2Status fmi2Terminate(fmi2Component c) { (void)c; return fmi2OK; }
VALVEMAP_EXPORT fmi2Status fmi2Reset(fmi2Component c) { start(c); return fmi2OK; }

/* References: 0 to 2 inputs, 3 to 8 real outputs, 9 and 10 statuses, 11 to 13 constants. */
VALVEMAP_EXPORT fmi2Status fmi2GetReal(
    fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Valve *valve = c;
    size_t k;
    evaluate(valve);
    for (k = 0; k < n; k++) {
        if (vr[k] < 3)
            value[k] = valve->input[vr[k]];
        else if (vr[k] < 9)
            value[k] = valve->real[vr[k] - 3];
        else if (vr[k] >= 11 && vr[k] < 14)
            value[k] = constants[vr[k] - 11];
        else
            return fmi2Error;
    }
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2GetInteger(
    fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    Valve *valve = c;
    size_t k;
    evaluate(valve);
    for (k = 0; k < n; k++) {
        if (vr[k] != 9 && vr[k] != 10)
            return fmi2Error;
        value[k] = valve->status[vr[k] - 9];
    }
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2SetReal(
    fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    size_t k;
    for (k = 0; k < n; k++) {
        if (vr[k] >= 3)
            return fmi2Error;
        ((Valve *)c)->input[vr[k]] = value[k];
    }
    return fmi2OK;
}

#define NONE_OF(NAME, TYPE) \
    VALVEMAP_EXPORT fmi2Status NAME( \
        fmi2Component c, const fmi2ValueReference vr[], size_t n, TYPE value[]) \
    { \
        (void)c; (void)vr; (void)value; \
        return n == 0 ? fmi2OK : fmi2Error; \
    }

NONE_OF(fmi2GetBoolean, fmi2Boolean)
NONE_OF(fmi2GetString, fmi2String)
NONE_OF(fmi2SetInteger, const fmi2Integer)
NONE_OF(fmi2SetBoolean, const fmi2Boolean)
NONE_OF(fmi2SetString, const fmi2String)

VALVEMAP_EXPORT fmi2Status fmi2DoStep(
    fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    ((Valve *)c)->time = time + step;
    evaluate(c);
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2GetRealStatus(fmi2Component c, fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = ((Valve *)c)->time;
    return fmi2OK;
}

/* The description says that these are not supported. */
VALVEMAP_EXPORT fmi2Status fmi2CancelStep(fmi2Component c) { (void)c; return fmi2Error; }

VALVEMAP_EXPORT fmi2Status fmi2GetStatus(fmi2Component c, fmi2StatusKind kind, fmi2Status *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}

VALVEMAP_EXPORT fmi2Status fmi2GetIntegerStatus(
    fmi2Component c, fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}

VALVEMAP_EXPORT fmi2Status fmi2GetBooleanStatus(
    fmi2Component c, fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}

VALVEMAP_EXPORT fmi2Status fmi2GetStringStatus(
    fmi2Component c, fmi2StatusKind kind, fmi2String *value)
{
    (void)c; (void)kind; (void)value;
    return fmi2Discard;
}

VALVEMAP_EXPORT fmi2Status fmi2SetRealInputDerivatives(
    fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
    const fmi2Real value[])
{
    (void)c; (void)vr; (void)n; (void)order; (void)value;
    return fmi2Error;
}

VALVEMAP_EXPORT fmi2Status fmi2GetRealOutputDerivatives(
    fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
    fmi2Real value[])
{
    (void)c; (void)vr; (void)n; (void)order; (void)value;
    return fmi2Error;
}

VALVEMAP_EXPORT fmi2Status fmi2GetDirectionalDerivative(
    fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
    const fmi2ValueReference known[], size_t n_known, const fmi2Real in[], fmi2Real out[])
{
    (void)c; (void)unknown; (void)n_unknown; (void)known; (void)n_known; (void)in; (void)out;
    return fmi2Error;
}

VALVEMAP_EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    *state = malloc(sizeof(Valve));
    if (*state == NULL)
        return fmi2Error;
    memcpy(*state, c, sizeof(Valve));
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    memcpy(c, state, sizeof(Valve));
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2SerializedFMUstateSize(
    fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c; (void)state;
    *size = sizeof(Valve);
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2SerializeFMUstate(
    fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    (void)c;
    if (size < sizeof(Valve))
        return fmi2Error;
    memcpy(bytes, state, sizeof(Valve));
    return fmi2OK;
}

VALVEMAP_EXPORT fmi2Status fmi2DeSerializeFMUstate(
    fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    (void)c;
    if (size != sizeof(Valve))
        return fmi2Error;
    *state = malloc(sizeof(Valve));
    if (*state == NULL)
        return fmi2Error;
    memcpy(*state, bytes, sizeof(Valve));
    return fmi2OK;
}
"""
