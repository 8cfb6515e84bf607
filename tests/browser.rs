//! A protocol page in a real browser: it loads whole, fits the window, and prints.

use crate::common::browser;

use calfit::data::note::{Note, NoteKind};
use calfit::show::document::{Block, Cell, Document, Figure, Section, Table, Text};
use calfit::show::html;
use std::fs;

/// A picture with a slope in it.
fn picture(width: u32, height: u32, colour: [u8; 3]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().unwrap();
    let pixel = |x: u32, y: u32| if (x * height).abs_diff(y * width) < 4 * width { colour } else { [250, 250, 250] };
    let pixels: Vec<u8> = (0..height).flat_map(|y| (0..width).flat_map(move |x| pixel(x, y))).collect();
    writer.write_image_data(&pixels).unwrap();
    writer.finish().unwrap();
    bytes
}

fn protocol() -> Document {
    let rows = (0..70).map(|run| {
        let column = |i: usize| match i {
            0 => Cell::from(format!("run {run}")),
            _ => Cell::uncertain(i as f64 + 0.982_145, f64::from(run + 10) * 1e-6),
        };
        (0..20).map(column).collect()
    });
    let table = Table::new((0..20).map(|i| format!("parameter {i}"))).with_rows(rows);
    let hash = "0123456789abcdef".repeat(4);
    let figure = |number, file: &str, title: &str, caption: &str| {
        Block::Figure(Figure { file: file.to_owned(), number, title: title.to_owned(), caption: caption.to_owned() })
    };
    let properties = Table::new(["property", "value"])
        .with_rows([vec!["serial number".into(), 3_usize.into()], vec!["hash".into(), Text::default().code(&hash).into()]]);
    let data = Section::new("Data").numbered("1.1").with(properties).with(figure(1, "figures/a.png", "A slope", "a slope"));
    let matrix = Section::new("Matrix")
        .numbered("1.2")
        .with(Block::Code("+0.999988   -0.004363   +0.012217\n".to_owned()))
        .with(Block::Code(hash.repeat(2)));
    let figures = Section::new("Figures")
        .numbered("3")
        .with(figure(2, "figures/b.png", "A steep slope", "a steep slope"))
        .with(figure(3, "figures/c.png", "Lost", "nothing"))
        .with(Block::List(vec!["<script>alert(1)</script>".into(), hash.repeat(2).into()]));
    Document {
        title: "Protocol \"of\" a <test> \\ campaign".to_owned(),
        front: vec![
            Note::new(NoteKind::Axes, "`+X` & `-X` are exchanged.").into(),
            Text::from("See ").link("the runs", "#2-runs").and(".").into(),
        ],
        sections: vec![
            Section::new("Sensor").numbered("1").with_sections([data, matrix]),
            Section::new("Runs").numbered("2").with(table),
            figures,
        ],
        colophon: None,
    }
}

#[test]
fn a_page_is_shown_and_printed_whole() {
    let page = html::page(&protocol(), &mut |path| match path {
        "figures/a.png" => Some(picture(1200, 750, [0, 114, 178])),
        "figures/b.png" => Some(picture(300, 900, [213, 94, 0])),
        _ => None,
    });
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("protocol.html");
    fs::write(&file, &page).unwrap();
    let Some(screens) = browser::screens(&file, &dir.path().join("screens")) else { return };
    assert_eq!(screens.dom.matches("<img ").count(), 2);
    assert!(screens.dom.contains("<code>figures/c.png</code> is missing"));
    assert!(screens.dom.contains("&lt;script&gt;alert(1)&lt;/script&gt;"));
    // Title page, sensor, three or more pages of runs, figures.
    assert!(screens.pages >= 6, "{} pages", screens.pages);
    // A table wider than the paper would make the browser shrink the whole text to many rows a page.
    assert!(screens.pages <= 12, "{} pages", screens.pages);
    if let Some(folder) = std::env::var_os("CALFIT_SCREENS") {
        let folder = std::path::Path::new(&folder);
        fs::create_dir_all(folder).unwrap();
        for file in screens.windows.iter().chain([&screens.pdf]) {
            fs::copy(file, folder.join(file.file_name().unwrap())).unwrap();
        }
    }
}
