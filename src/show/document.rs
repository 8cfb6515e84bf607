//! What people read of a result, before it has a form: sections with text, tables, figures, notes and listings.
//!
//! The modules of the analyses build a [`Document`]; [`markdown`](super::markdown) and [`html`](super::html) write it, each from the
//! same types and neither from the other. A writer never has to guess: a cell says whether it is a number, a heading carries its number
//! apart from its words, and code inside a sentence is marked as such.

mod table;
mod text;

pub(super) use table::NOT_DETERMINED;
pub(super) use table::cells;
pub use table::{Cell, Form, Number, Table};
pub use text::{Inline, Text};

use crate::data::note::Note;

/// A report or protocol.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Document {
    /// Its title, without markup.
    pub title: String,
    /// What stands in front of the first section.
    pub front: Vec<Block>,
    /// Its sections; those of the protocol are chapters, numbered by whoever builds them.
    pub sections: Vec<Section>,
    /// The last line, below a rule: what the document was made with.
    pub colophon: Option<Text>,
}

/// A part under a heading.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Section {
    /// Number of the heading, such as `3.2`.
    pub number: Option<String>,
    /// Words of the heading.
    pub title: Text,
    /// What stands under the heading.
    pub blocks: Vec<Block>,
    /// Sections of the next level.
    pub sections: Vec<Section>,
}

/// A piece of a document.
#[derive(Clone, Debug, PartialEq)]
pub enum Block {
    /// A paragraph.
    Text(Text),
    /// Items, each with a mark in front of it.
    List(Vec<Text>),
    /// A table.
    Table(Table),
    /// Lines of fixed pitch, such as a matrix or a formula.
    Code(String),
    /// A warning that is to be seen.
    Note(Note),
    /// A picture.
    Figure(Figure),
}

/// A picture that was written to a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Figure {
    /// Path of the picture from the document, with forward slashes.
    pub file: String,
    /// Number in the document, from 1.
    pub number: usize,
    /// What it shows.
    pub title: String,
    /// What to see in it.
    pub caption: String,
}

impl Section {
    /// An empty section without a number.
    #[must_use]
    pub fn new(title: impl Into<Text>) -> Self {
        Self { title: title.into(), ..Self::default() }
    }

    /// The same with a number in front of the heading.
    #[must_use]
    pub fn numbered(mut self, number: impl Into<String>) -> Self {
        self.number = Some(number.into());
        self
    }

    /// The same with one block more.
    #[must_use]
    pub fn with(mut self, block: impl Into<Block>) -> Self {
        self.push(block);
        self
    }

    /// The same with more blocks.
    #[must_use]
    pub fn with_all<B: Into<Block>>(mut self, blocks: impl IntoIterator<Item = B>) -> Self {
        self.blocks.extend(blocks.into_iter().map(Into::into));
        self
    }

    /// The same with sections of the next level.
    #[must_use]
    pub fn with_sections(mut self, sections: impl IntoIterator<Item = Section>) -> Self {
        self.sections.extend(sections);
        self
    }

    /// Adds a block.
    pub fn push(&mut self, block: impl Into<Block>) {
        self.blocks.push(block.into());
    }

    /// The heading as one line of words.
    #[must_use]
    pub fn heading(&self) -> String {
        self.number.iter().cloned().chain([self.title.plain()]).collect::<Vec<_>>().join(" ")
    }
}

impl From<Text> for Block {
    fn from(text: Text) -> Self {
        Block::Text(text)
    }
}

impl From<String> for Block {
    fn from(words: String) -> Self {
        Block::Text(words.into())
    }
}

impl From<&str> for Block {
    fn from(words: &str) -> Self {
        Block::Text(words.into())
    }
}

impl From<Table> for Block {
    fn from(table: Table) -> Self {
        Block::Table(table)
    }
}

impl From<Note> for Block {
    fn from(note: Note) -> Self {
        Block::Note(note)
    }
}

impl From<Figure> for Block {
    fn from(figure: Figure) -> Self {
        Block::Figure(figure)
    }
}
