//! `inerter calibrate` without a step: all of them, in a dialogue.

use super::{
    super::{
        args::LinkArgs,
        terminal::{self, note},
    },
    person::Person,
};
use crate::{Error, calibrate::wizard::Wizard, error::DialogueError};

pub fn run(link: &LinkArgs) -> Result<(), Error> {
    if !terminal::can_ask() {
        return Err(DialogueError::NoTerminal.into());
    }
    terminal::catch_interrupts();
    let mut device = link.device()?;
    let save = if device.keeps_settings() { " --save" } else { "" };
    let mut person = Person::new(false);
    let mut wizard = Wizard::new(&mut device, &mut person);
    let result = wizard.run();
    let accepted = wizard.accepted();
    if result.is_err() && !accepted.is_empty() {
        // Below the question on screen.
        terminal::say("");
        let set: Vec<String> = accepted.iter().map(|(name, _, value)| format!("{name}={value:?}")).collect();
        note(format!("the accepted values are not on the device yet: inerter settings set {}{save}", set.join(" ")));
    }
    result.map(|_| ())
}
