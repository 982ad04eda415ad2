//! Reads from frames of H.264 whether they are key frames, and how large the pictures are.
#[cfg(feature = "video")]
use h264_reader::{
    nal::{sps::SeqParameterSet, Nal, RefNal},
    rbsp::BitReader,
};

#[cfg(feature = "video")]
use super::FORMAT;
use crate::message::{encoding::EncodingKind, payload::Payload};
#[cfg(feature = "video")]
use crate::{
    codec::Limits,
    message::codec_error::{damaged, CodecError},
};

const SLICE: u8 = 1;
const KEY_SLICE: u8 = 5;
const PARAMETERS: u8 = 7;
#[cfg(feature = "video")]
const PICTURE_PARAMETERS: u8 = 8;

/// Returns whether a payload is a frame of a video.
pub fn is_video(payload: &Payload) -> bool {
    payload.encoding.kind() == EncodingKind::H264
}

/// Returns whether a decoder can begin with this frame: it has parameter sets, and refers to no other frame.
pub fn is_key_frame(bytes: &[u8]) -> bool {
    let mut has_parameters = false;
    for unit in units(bytes) {
        match kind(unit) {
            PARAMETERS => has_parameters = true,
            KEY_SLICE => return has_parameters,
            SLICE => return false,
            _ => {}
        }
    }
    false
}

/// Returns the units of a frame, each of which begins with a byte for its kind.
pub fn units(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = after_start(bytes);
    std::iter::from_fn(move || {
        let unit = rest?;
        let end = start(unit).unwrap_or(unit.len());
        rest = after_start(&unit[end..]);
        // Zeros belong to the next start code.
        let length = unit[..end].iter().rposition(|&byte| byte != 0);
        Some(&unit[..length.map_or(0, |last| last + 1)])
    })
    .filter(|unit| !unit.is_empty())
}

/// Returns the kind of a unit, such as 7 for a sequence's parameters; table 7-1 of the standard.
pub fn kind(unit: &[u8]) -> u8 {
    unit.first().map_or(0, |header| header & 0x1f)
}

/// Returns where the next start code is.
fn start(bytes: &[u8]) -> Option<usize> {
    bytes.windows(3).position(|three| three == [0, 0, 1])
}

fn after_start(bytes: &[u8]) -> Option<&[u8]> {
    start(bytes).map(|at| &bytes[at + 3..])
}

/// The parameters that a decoder needs before the first slice.
#[cfg(feature = "video")]
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parameters {
    /// The width in pixels.
    pub width: u32,
    /// The height in pixels.
    pub height: u32,
    /// The unit with the parameters of the sequence.
    pub sequence: Vec<u8>,
    /// The unit with the parameters of the pictures.
    pub picture: Vec<u8>,
}

#[cfg(feature = "video")]
impl Parameters {
    /// Returns the parameters that a frame contains; `None` if there are none, or they are damaged.
    pub fn of(frame: &[u8]) -> Option<Self> {
        let find = |number| units(frame).find(|unit| kind(unit) == number);
        let (sequence, picture) = (find(PARAMETERS)?, find(PICTURE_PARAMETERS)?);
        let (width, height) = read(sequence).ok()?.pixel_dimensions().ok()?;
        Some(Self {
            width,
            height,
            sequence: sequence.to_vec(),
            picture: picture.to_vec(),
        })
    }
}

#[cfg(feature = "video")]
fn read(unit: &[u8]) -> Result<SeqParameterSet, CodecError> {
    let unit = RefNal::new(unit, &[], true);
    let parameters = SeqParameterSet::from_bits(BitReader::new(unit.rbsp_bytes()));
    parameters.map_err(|error| damaged(FORMAT, format!("{error:?}")))
}

/// Checks that a decoder needs no more memory for a frame than the limits allow: for its picture, and for those that it
/// refers to.
///
/// # Errors
/// Returns a [`CodecError`] if the parameter sets of the frame are damaged, or demand more.
#[cfg(feature = "video")]
pub fn check(bytes: &[u8], limits: &Limits) -> Result<(), CodecError> {
    for unit in units(bytes).filter(|unit| kind(unit) == PARAMETERS) {
        let parameters = read(unit)?;
        let size = parameters.pixel_dimensions();
        let (width, height) = size.map_err(|error| damaged(FORMAT, format!("{error:?}")))?;
        limits.picture(FORMAT, [width, height], 3)?;
        if !super::fits(width, height) {
            let [long, short] = super::MAX_SIDES;
            return Err(CodecError::TooLarge {
                format: FORMAT,
                found: format!("{width}x{height} pixels"),
                limit: format!("{long}x{short} pixels"),
            });
        }
        let pictures = u64::from(parameters.max_num_ref_frames) + 1;
        // Three bytes for two pixels.
        let bytes = u64::from(width) * u64::from(height) * 3 / 2;
        limits.bytes(FORMAT, bytes.saturating_mul(pictures))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_frames_have_parameters_and_a_key_slice() {
        let key = [
            0, 0, 0, 1, 0x67, 1, 2, 0, 0, 1, 0x68, 3, 0, 0, 0, 1, 0x65, 4,
        ];
        assert!(is_key_frame(&key));
        let kinds: Vec<u8> = units(&key).map(kind).collect();
        assert_eq!(kinds, [7, 8, 5]);
        for other in [
            &key[..12],
            &key[12..],
            &[0, 0, 1, 0x41, 9],
            &[0, 0, 1],
            &[0, 0, 1, 0, 0, 1],
            b"JPEG",
            &[],
        ] {
            assert!(!is_key_frame(other), "{other:?}");
        }
    }
}
