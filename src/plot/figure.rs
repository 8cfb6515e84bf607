//! What a figure consists of.

use super::rows::CellRow;

/// A picture of one to three panels above a common x axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Printed at the top left and kept as the title of the picture.
    pub title: String,
    /// One or two sentences printed below the plot and kept as the description of the picture.
    pub caption: String,
    /// Quantity and unit of the x axis.
    pub x_label: String,
    /// Scale of the x axis.
    pub x_scale: Scale,
    /// From top to bottom.
    pub panels: Vec<Panel>,
}

/// One plot of a [`Figure`].
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Quantity and unit of the y axis.
    pub y_label: String,
    /// Scale of the y axis.
    pub y_scale: Scale,
    /// Data to show.
    pub series: Vec<Series>,
    /// Ranges of y to set off behind the data.
    pub bands: Vec<Band>,
}

/// How values are spread along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scale {
    /// Equal differences are equal lengths.
    #[default]
    Linear,
    /// Equal ratios are equal lengths; values that are not positive are left out.
    Logarithmic,
    /// Hours since the beginning of a day, with labels as on a clock.
    TimeOfDay,
}

/// Data drawn with one style.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend; without one the series has no legend entry.
    pub label: String,
    /// Colour, marker shape, dashes and line width.
    pub style: Style,
    /// The data and the way they are drawn.
    pub marks: Marks,
}

/// What a series stands for; the styles differ in more than colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// First component: blue, solid, circles.
    X,
    /// Second component: vermilion, dashed, squares.
    Y,
    /// Third component: green, dotted, triangles.
    Z,
    /// The only series of a panel: black, solid, circles.
    Single,
    /// A second series beside [`Style::Single`]: purple, dashed, diamonds.
    Second,
    /// A model, limit or nominal value: grey, thin, long dashes.
    Reference,
}

/// Data and the way they are drawn. Values that are not finite are left out.
#[derive(Debug, Clone, PartialEq)]
pub enum Marks {
    /// A few points (x, y), joined; a value that is not finite breaks the line.
    Line(Vec<(f64, f64)>),
    /// Settings (start, end, y), with thin joins where they follow each other closely; one that is
    /// not finite in between parts them.
    Steps(Vec<(f64, f64, f64)>),
    /// Points (x, y, standard uncertainty).
    Points(Vec<(f64, f64, Option<f64>)>),
    /// Points (x, y) that were measured but not used. Those far outside the range of the other
    /// data are shown as arrows at the edge of the panel and counted in the legend.
    Rejected(Vec<(f64, f64)>),
    /// Dense data as the extent of each column.
    Envelope(Vec<Column>),
    /// A band along a curve (x, low, high), behind everything else; an end that is not positive
    /// lies below the panel of a logarithmic y axis.
    Ribbon(Vec<(f64, f64, f64)>),
    /// Bars from one value to another in rows with a name each, from top to bottom; the panel has names instead of a y axis.
    Bars(Vec<(String, Vec<(f64, f64)>)>),
    /// Rows of cells, from top to bottom; the panel has names instead of a y axis.
    Cells(Vec<CellRow>),
    /// Names of places on the x axis, which has them in place of numbers.
    Names(Vec<(f64, String)>),
    /// Places (x, y) that the axes have to show, with nothing drawn: panels that are compared have one scale.
    Shown(Vec<(f64, f64)>),
}

/// Extent of dense data in one column of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Column {
    /// Centre of the column.
    pub x: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

/// A range of y set off by a light ground.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Name in the legend; without one the band has no legend entry.
    pub label: String,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}
