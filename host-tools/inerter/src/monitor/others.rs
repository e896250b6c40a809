//! Views in other programs: the page in a browser, Teleplot, PlotJuggler and Foxglove.
//!
//! The options always exist. A program that was built without the feature `bridges` refuses them ([`Wanted::check`]).

use super::{
    address::{FOXGLOVE, PAGE, PLOTJUGGLER, TELEPLOT},
    hub::Hub,
};
use crate::{Error, feature::Feature};

/// What is to be opened.
#[derive(clap::Args)]
pub struct Wanted {
    /// Serve a page to browsers on this machine, at the printed address
    #[arg(long, help_heading = "Other views")]
    web: bool,
    /// Loopback address of the page; port 0 takes any free one
    #[arg(long, value_name = "HOST:PORT", default_value = PAGE, requires = "web", help_heading = "Other views")]
    bind: String,
    /// Send samples and estimates to Teleplot (UDP)
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = TELEPLOT, help_heading = "Other views")]
    teleplot: Option<String>,
    /// Send samples and estimates to PlotJuggler (UDP server, protocol JSON)
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = PLOTJUGGLER, help_heading = "Other views")]
    plotjuggler: Option<String>,
    /// Serve samples and estimates to Foxglove (WebSocket)
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = FOXGLOVE, help_heading = "Other views")]
    pub foxglove: Option<String>,
    /// Let pages of this origin connect too (--foxglove), e.g. `https://plots.example`; may be repeated
    #[arg(long, value_name = "ORIGIN", requires = "foxglove", help_heading = "Other views")]
    foxglove_origin: Vec<String>,
}

/// The name of a view, and its address.
pub type Place = (&'static str, String);

impl Wanted {
    /// Fails if a view is requested that is not built in.
    pub fn check(&self) -> Result<(), Error> {
        let mut wanted = [
            ("--web", self.web),
            ("--teleplot", self.teleplot.is_some()),
            ("--plotjuggler", self.plotjuggler.is_some()),
            ("--foxglove", self.foxglove.is_some()),
        ]
        .into_iter();
        wanted.try_for_each(|(option, is_given)| {
            Feature::BRIDGES.check(option, is_given, "lines, --json and --share are always built in")
        })
    }

    /// Opens the requested views and adds them to the hub.
    #[cfg(feature = "bridges")]
    pub fn open(&self, hub: &mut Hub, recording: Option<String>) -> Result<Vec<Place>, Error> {
        use super::{
            bridge::{Foxglove, PlotJuggler, Teleplot},
            web::Web,
        };

        let mut places = Vec::new();
        if self.web {
            let web = Web::start(&self.bind, hub.wishes(), recording)?;
            places.push(("page", web.url.clone()));
            hub.add(web);
        }
        if let Some(address) = &self.teleplot {
            hub.add(Teleplot::new(address)?);
            places.push(("Teleplot", format!("udp://{address}")));
        }
        if let Some(address) = &self.plotjuggler {
            hub.add(PlotJuggler::new(address)?);
            places.push(("PlotJuggler", format!("udp://{address}")));
        }
        if let Some(address) = &self.foxglove {
            let foxglove = Foxglove::new(address, &self.foxglove_origin)?;
            places.push(("Foxglove", foxglove.address.clone()));
            hub.add(foxglove);
        }
        Ok(places)
    }

    /// Nothing is left to open: [`Self::check`] has refused the request.
    #[cfg(not(feature = "bridges"))]
    pub fn open(&self, _: &mut Hub, _: Option<String>) -> Result<Vec<Place>, Error> {
        self.check()?;
        Ok(Vec::new())
    }
}
