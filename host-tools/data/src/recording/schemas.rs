//! JSON schemas of the decoded channels: the descriptions that PlotJuggler and Foxglove show beside the numbers.
//!
//! Types are plain (`number`, never a list of types), as Foxglove requires; an unknown number is nevertheless `null`.

use inerter_core::Machine;
use inerter_wire::catalogue::{self, Field, Group};
use serde_json::{Map, Value, json};

use super::decode::Channel;
use crate::{json::machine_json_line, names, words::bracketed};

const INTERVAL: &str = "half width of the 95 % interval; null if it is not finite";

/// The schema of a channel, as text.
pub(super) fn schema(machine: Machine, channel: Channel) -> String {
    let (title, properties) = match channel {
        Channel::Motion => ("Means over 50 ms of samples", motion()),
        Channel::Estimate => ("Estimates of the device, once a second", estimate()),
        Channel::Reversal => ("Backlash at each reversal of the flanks, at most ten per second", reversal()),
        Channel::Event => ("Something that happened once", event()),
        Channel::Health => ("Health of the device", health()),
        Channel::Marker => ("Remarks made during the recording", marker()),
    };
    let mut schema = json!({"title": title, "type": "object", "properties": properties});
    describe(machine, &mut schema);
    machine_json_line(machine, &schema)
}

/// Rewrites the descriptions in the words of this machine.
fn describe(machine: Machine, schema: &mut Value) {
    for (key, value) in schema.as_object_mut().into_iter().flatten() {
        match value {
            Value::String(text) if key == "description" => *text = names::description(machine, text),
            _ => describe(machine, value),
        }
    }
}

fn number(description: impl AsRef<str>) -> Value {
    json!({"type": "number", "description": description.as_ref()})
}

fn text(description: &str) -> Value {
    json!({"type": "string", "description": description})
}

fn described(field: &Field) -> String {
    field.label.to_owned() + &bracketed(field.unit)
}

fn kind() -> Value {
    text("kind of the message")
}

fn time() -> Value {
    number("time of the sample since the first one of the recording [s]")
}

fn motion() -> Value {
    json!({
        "t_s": number("middle of the averaged samples, since the first sample of the recording [s]"),
        "position_m": number("mean displacement of the screw [m]"),
        "force_n": number("mean force [N]"),
        "force_min_n": number("minimum force [N]"),
        "force_max_n": number("maximum force [N]"),
        "terminal_m": number("mean displacement of the terminal; absent without its sensor [m]"),
    })
}

/// The parameters in a group of the catalogue, each with its interval.
fn parameters<'a>(fields: impl Iterator<Item = &'a Field>) -> Map<String, Value> {
    let parameter = |field: &Field| {
        json!({"type": "object", "description": described(field), "properties": {
            "value": number(format!("{}; null when not identifiable", described(field))),
            "u95": number(INTERVAL),
            "status": text("ok, below_u95, held or not_identifiable"),
        }})
    };
    fields.map(|field| (field.path.to_string(), parameter(field))).collect()
}

fn estimate() -> Value {
    let four = || parameters(catalogue::fields(Machine::Linear, Group::Parameter));
    let mut properties = Map::from_iter([("kind".to_string(), kind()), ("t_s".to_string(), time())]);
    let whole = json!({"type": "object", "description": "the same four, from all motion so far", "properties": four()});
    properties.insert("whole_run".into(), whole);
    properties.extend(four());
    let contact = catalogue::contact_fields(Machine::Linear);
    properties.extend(parameters(contact));
    let rest = json!({
        "moving": {"type": "boolean", "description": "whether the machine moves"},
        "bank": text("kernel length in use: fast or slow"),
        "residual_rms_n": number("rms force that the model does not explain [N]"),
        "updates": number("updates since the estimator started"),
        "backlash_m": {"type": "object", "properties": {
            "value": number("total play between the flanks [m]"),
            "u95": number(INTERVAL),
            "status": text("ok, below_u95 or not_identifiable"),
            "reason": text("why it is not identifiable, else null"),
            "reversals": number("reversals from which it was found"),
            "route": text("force or terminal"),
        }},
        "band_hz": {"type": "array", "items": {"type": "number"}, "description": "band in which the inertance was measured [Hz]"},
        "contact": text("unknown, one_sided, closed, backlash or bouncing"),
        "friction": {"type": "object", "properties": {
            "reversal_ratio": number("kink observed in the velocity at reversals, as a fraction of the kink that Coulomb friction would cause"),
            "regime": text("unknown, coulomb, presliding or stribeck"),
        }},
        "law": {"type": "object", "properties": {
            "status": text("holds, broken or unknown"),
            "ratio": number("residual over what noise and steps explain; null until known"),
            "limit": number("the ratio stays below it where the law holds; null until known"),
        }},
        "changes": number("changes of the device found since the estimator started"),
    });
    properties.extend(rest.as_object().cloned().unwrap_or_default());
    properties.into()
}

fn reversal() -> Value {
    json!({
        "kind": kind(),
        "t_s": time(),
        "index": number("sample counter at the middle of the flight"),
        "value_m": number("backlash from this reversal alone [m]"),
        "error_m": number("its standard error [m]"),
        "route": text("force or terminal"),
        "rising": {"type": "boolean", "description": "from the negative to the positive flank"},
    })
}

fn event() -> Value {
    json!({
        "kind": kind(),
        "t_s": time(),
        "index": number("sample counter"),
        "code": text("code for programs"),
        "event": text("description for people"),
        "parameter": text("parameter that changed"),
        "before": number("its value before, in the unit of its name"),
        "after": number("its value after"),
    })
}

fn health() -> Value {
    let fields = catalogue::fields(Machine::Linear, Group::Health)
        .map(|field| (field.path.to_string(), number(described(field))));
    std::iter::once(("kind".to_string(), kind())).chain(fields).collect::<Map<_, _>>().into()
}

fn marker() -> Value {
    json!({"t_ns": {"type": "integer", "description": "host time [ns]"}, "text": text("the remark")})
}
