//! Serialised forms of core's values with intervals: value, half width and status side by side, whatever the status. If
//! nothing is known, the value is 0 and the half width infinite.

use inerter_core::{
    BacklashSize, BacklashStatus, Band, Bank, Contact, Friction, Interval, Misfit, Parameter as Value, Route, Status,
    Unresolved,
};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

const NOTHING: Interval = Interval { value: 0.0, u95: f32::INFINITY };

#[derive(Serialize, Deserialize)]
#[serde(remote = "inerter_core::Estimate")]
pub(crate) struct Estimate {
    index: u32,
    elapsed_samples: u64,
    bank: Bank,
    moving: bool,
    #[serde(with = "Parameters")]
    recent: inerter_core::Parameters,
    #[serde(with = "Parameters")]
    whole_run: inerter_core::Parameters,
    residual_rms_n: f32,
    updates: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "inerter_core::Parameters")]
struct Parameters {
    #[serde(with = "Parameter")]
    inertance_kg: Value,
    #[serde(with = "Parameter")]
    viscous_n_s_per_m: Value,
    #[serde(with = "Parameter")]
    coulomb_n: Value,
    #[serde(with = "Parameter")]
    offset_n: Value,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "inerter_core::Detail")]
pub(crate) struct Detail {
    index: u32,
    band: Band,
    #[serde(with = "Backlash")]
    backlash: inerter_core::Backlash,
    contact: Contact,
    #[serde(with = "Parameter")]
    stiffness_n_per_m: Value,
    #[serde(with = "Parameter")]
    contact_damping_n_s_per_m: Value,
    friction: Friction,
    changes: u32,
}

/// Unchanged, except that a law with a NaN or infinite misfit says nothing.
pub(crate) struct Law;

impl Law {
    pub(crate) fn serialize<S: Serializer>(law: &inerter_core::Law, serializer: S) -> Result<S::Ok, S::Error> {
        law.serialize(serializer)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<inerter_core::Law, D::Error> {
        let law = inerter_core::Law::deserialize(deserializer)?;
        let told = law.misfit.is_none_or(|Misfit { ratio, limit }| ratio.is_finite() && limit.is_finite());
        Ok(if told { law } else { inerter_core::Law { index: law.index, ..Default::default() } })
    }
}

#[derive(Serialize, Deserialize)]
struct Parameter {
    value: f32,
    u95: f32,
    status: Status,
}

impl Parameter {
    fn serialize<S: Serializer>(parameter: &Value, serializer: S) -> Result<S::Ok, S::Error> {
        let Interval { value, u95 } = parameter.fitted();
        Serialize::serialize(&Self { value, u95, status: parameter.status() }, serializer)
    }

    fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Value, D::Error> {
        let Self { value, u95, status } = Deserialize::deserialize(deserializer)?;
        // Before its first fit, older firmware sent zeros.
        if status == Status::NotIdentifiable && u95 == 0.0 {
            return Ok(Value::NotIdentifiable(Unresolved::NOTHING));
        }
        Ok(Value::new(Interval { value, u95 }, status))
    }
}

#[derive(Serialize, Deserialize)]
struct Backlash {
    value_m: f32,
    u95_m: f32,
    status: BacklashStatus,
    route: Route,
    reversals: u32,
}

impl Backlash {
    fn serialize<S: Serializer>(backlash: &inerter_core::Backlash, serializer: S) -> Result<S::Ok, S::Error> {
        let Interval { value, u95 } = backlash.known().unwrap_or(NOTHING);
        let inerter_core::Backlash { route, reversals, .. } = *backlash;
        Serialize::serialize(
            &Self { value_m: value, u95_m: u95, status: backlash.status(), route, reversals },
            serializer,
        )
    }

    fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<inerter_core::Backlash, D::Error> {
        let Self { value_m, u95_m, status, route, reversals } = Deserialize::deserialize(deserializer)?;
        let interval = Interval { value: value_m, u95: u95_m };
        let size = match status {
            BacklashStatus::BelowU95 | BacklashStatus::Ok if !(value_m.is_finite() && u95_m.is_finite()) => {
                BacklashSize::default()
            }
            BacklashStatus::NotIdentifiable(reason) => BacklashSize::NotIdentifiable(reason),
            BacklashStatus::BelowU95 => BacklashSize::BelowU95(interval),
            BacklashStatus::Ok => BacklashSize::Ok(interval),
        };
        Ok(inerter_core::Backlash { size, route, reversals })
    }
}
