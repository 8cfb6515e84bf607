//! A protocol page in a real browser: it loads whole, fits the window, and prints.

use crate::common::browser;

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

fn protocol() -> String {
    let wide = |cell: &dyn Fn(usize) -> String| format!("| {} |\n", (0..20).map(cell).collect::<Vec<_>>().join(" | "));
    let mut table = wide(&|i| format!("parameter {i}"));
    table.push_str(&format!("|{}\n", "---|".repeat(20)));
    for run in 0..70 {
        table.push_str(&wide(&|i| if i == 0 { format!("run {run}") } else { format!("+{i}.982145 ± 0.0000{run:02}") }));
    }
    let hash = "0123456789abcdef".repeat(4);
    format!(
        "<!-- written by calfit 0.0.0 -->\n# Protocol of a <test> campaign\n\n> **WARNING** AXES: `+X` & `-X` are exchanged.\n\nSee [the \
         runs](#2-runs).\n\n## 1 Sensor\n\n### 1.1 Data\n\n| property | value |\n|---|---|\n| serial number | 3 |\n| hash | `{hash}` |\n\n\
         ![a slope](figures/a.png \"Figure 1: A slope\")\n\n### 1.2 Matrix\n\n    +0.999988   -0.004363   +0.012217\n\n```\n{hash}{hash}\n\
         ```\n\n## 2 Runs\n\n{table}\n## 3 Figures\n\n![a steep slope](figures/b.png \"Figure 2: A steep slope\")\n\n![nothing](figures/c.png \
         \"Figure 3: Lost\")\n\n- <script>alert(1)</script>\n- {hash}{hash}\n"
    )
}

#[test]
fn a_page_is_shown_and_printed_whole() {
    let page = html::page(&protocol(), "Protocol \"of\" a <test> \\ campaign", &mut |path| match path {
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
