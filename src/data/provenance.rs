//! Where a result comes from: tool, command, time, inputs with hashes.

use crate::data::recipe::{Recipe, RecipeError};
use crate::data::run::Run;
use crate::data::start::Start;
use serde::{Deserialize, Serialize};

/// What an input is for, where it is not what is analysed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// What is known of the campaign.
    Campaign,
    /// The facility that turns settings into fields.
    Facility,
    /// The linearisation of the readings.
    Linearisation,
    /// Known effects.
    Model,
    /// What the parameters follow of the sensor temperature.
    Temperature,
    /// The linear calibration whose sensitivities give nT.
    Cpf,
    /// The linear calibration at the centre of the coil system.
    Centre,
    /// The linear calibration beside the centre.
    OffCentre,
    /// The offset at the centre.
    Offset,
    /// Readings beside a reference thermometer.
    Reference,
    /// A table of amplitudes in place of a run.
    Amplitudes,
}

impl Role {
    /// The option that names such a file.
    #[must_use]
    pub fn option(self) -> &'static str {
        match self {
            Role::Campaign => "campaign",
            Role::Facility => "facility",
            Role::Linearisation => "linearisation",
            Role::Model => "model",
            Role::Temperature => "temperature",
            Role::Cpf => "cpf",
            Role::Centre => "centre",
            Role::OffCentre => "off-centre",
            Role::Offset => "offset",
            Role::Reference => "reference",
            Role::Amplitudes => "amplitudes",
        }
    }
}

/// One input of a result. Inputs are the same where the file is and what it is for.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Input {
    /// Path inside the campaign, with forward slashes.
    pub path: String,
    /// Size, bytes.
    pub size_bytes: u64,
    /// SHA-256 of the bytes, hexadecimal.
    pub sha256: String,
    /// What it is for; absent for what is analysed, and in files that were made before there were recipes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub role: Option<Role>,
    /// Of a run file: when its data begin; absent for other files, and in files from before it was told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<Start>,
    /// When they end, to the second.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until: Option<Start>,
}

impl PartialEq for Input {
    fn eq(&self, other: &Self) -> bool {
        let key = |own: &Self| (own.size_bytes, own.role);
        key(self) == key(other) && self.path == other.path && self.sha256 == other.sha256
    }
}

impl Input {
    /// The same for something.
    #[must_use]
    pub fn with_role(self, role: Role) -> Self {
        Self { role: Some(role), ..self }
    }

    /// Whether it is a run file, by its name.
    #[must_use]
    pub fn is_run(&self) -> bool {
        let name = self.path.to_ascii_uppercase();
        name.ends_with(".CCR") || name.ends_with(".CCR.GZ")
    }
}

impl From<&Run> for Input {
    fn from(run: &Run) -> Self {
        let (file, start) = (&run.input, &run.header.start);
        Self {
            path: file.path.clone(),
            size_bytes: file.size_bytes,
            sha256: file.sha256.clone(),
            role: None,
            from: Some(start.clone()),
            until: Some(start.after(run.duration_s())),
        }
    }
}

/// What is written into every parameter file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// `calfit`.
    pub tool: String,
    /// Its version.
    pub tool_version: String,
    /// Machine and build for which the program was compiled.
    pub build: String,
    /// The command with every option that has an influence on the numbers, and without paths; written from the recipe for people.
    pub command: String,
    /// When, RFC 3339, UTC. `SOURCE_DATE_EPOCH` fixes it.
    pub created: String,
    /// What it was made with; absent in files that were made before there were recipes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recipe: Option<Recipe>,
    /// The inputs.
    pub input: Vec<Input>,
}

impl Provenance {
    /// Provenance of a result made now.
    #[must_use]
    pub fn new(recipe: Recipe, input: Vec<Input>) -> Self {
        Self {
            tool: env!("CARGO_PKG_NAME").to_owned(),
            tool_version: env!("CARGO_PKG_VERSION").to_owned(),
            build: build(),
            command: recipe.command(&input),
            created: created(),
            recipe: Some(recipe),
            input,
        }
    }

    /// The same with one more input.
    #[must_use]
    pub fn with_input(mut self, input: Input) -> Self {
        self.input.push(input);
        if let Some(recipe) = &self.recipe {
            self.command = recipe.command(&self.input);
        }
        self
    }

    /// What it was made with; of a file without a recipe what its command says, which gives the inputs their roles.
    ///
    /// # Errors
    /// A command that this version does not have.
    pub fn recipe(&mut self) -> Result<Recipe, RecipeError> {
        match &self.recipe {
            Some(recipe) => Ok(recipe.clone()),
            None => Recipe::of_command(&self.command, &mut self.input),
        }
    }
}

/// Machine, profile and features for which the program was compiled, and the commit of its source where the build was told it.
fn build() -> String {
    let profile = if cfg!(debug_assertions) { "debug" } else { "release" };
    let features = if cfg!(feature = "tables") { "" } else { ", without tables" };
    let commit = option_env!("CALFIT_COMMIT").map_or_else(String::new, |commit| format!(", commit {commit}"));
    format!("{}-{} {profile}{features}{commit}", std::env::consts::ARCH, std::env::consts::OS)
}

/// Now, or the time of `SOURCE_DATE_EPOCH`, to the second.
fn created() -> String {
    let fixed = std::env::var("SOURCE_DATE_EPOCH").ok().and_then(|v| v.parse::<i64>().ok());
    let time = match fixed.map(jiff::Timestamp::from_second) {
        Some(Ok(time)) => time,
        _ => jiff::Timestamp::now(),
    };
    time.strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
}
