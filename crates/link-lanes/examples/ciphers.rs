//! Measures the processor time of sealing and opening an SDU: with the link's own keys (AES-128-CCM with tags of 8 bytes), and
//! with ChaCha20-Poly1305 for comparison. Also that of agreeing on the keys. Prints one line of JSON for each.
//!
//! `packaging/footprint/run` runs it on an emulated Raspberry Pi 3B, whose cores have no AES instructions.
use std::{convert::Infallible, error::Error, hint::black_box, time::Instant};

use chacha20poly1305::{aead::AeadInPlace, ChaCha20Poly1305, KeyInit, Nonce};
use link_lanes::{
    key_agreement::{respond, Initiator},
    seal::{LinkKeys, TAG_BYTES},
    secret::Secret,
};

/// A telemetry sample, and the largest SDU on a Raspberry Pi 3B.
const SDU_BYTES: [usize; 2] = [40, 1000];
const SDUS: u32 = 2000;
const AGREEMENTS: u32 = 20;

fn main() -> Result<(), Box<dyn Error>> {
    for bytes in SDU_BYTES {
        let us = aes_ccm_us(bytes)?;
        println!("{{\"cipher\": \"AES-128-CCM\", \"bytes\": {bytes}, \"us\": {us:.2}}}");
        let us = chacha_us(bytes)?;
        println!("{{\"cipher\": \"ChaCha20-Poly1305\", \"bytes\": {bytes}, \"us\": {us:.2}}}");
    }
    let us = agreement_us()?;
    println!("{{\"cipher\": \"key agreement\", \"bytes\": 0, \"us\": {us:.0}}}");
    Ok(())
}

/// Returns the microseconds of one sealing and one opening.
fn aes_ccm_us(bytes: usize) -> Result<f64, Box<dyn Error>> {
    let (one, two) = ([1; 32], [2; 32]);
    let (mut sender, mut receiver) = (LinkKeys::new(one, two), LinkKeys::new(two, one));
    let mut sdu = vec![0; bytes];
    let start = Instant::now();
    for _ in 0..SDUS {
        sender
            .sealing
            .seal(&mut sdu, |_| Ok::<_, Infallible>(true))?;
        receiver.opening.open(&mut sdu)?;
        sdu.truncate(black_box(&sdu).len() - TAG_BYTES);
    }
    Ok(us_each(start, SDUS))
}

/// Returns the same for ChaCha20-Poly1305.
fn chacha_us(bytes: usize) -> Result<f64, Box<dyn Error>> {
    let cipher = ChaCha20Poly1305::new(&[1; 32].into());
    let mut sdu = vec![0; bytes];
    let start = Instant::now();
    for number in 0..SDUS {
        let mut nonce = Nonce::default();
        nonce[..4].copy_from_slice(&number.to_le_bytes());
        let (head, body) = sdu.split_at_mut(1);
        let tag = cipher
            .encrypt_in_place_detached(&nonce, head, body)
            .map_err(|e| e.to_string())?;
        cipher
            .decrypt_in_place_detached(&nonce, head, body, &tag)
            .map_err(|e| e.to_string())?;
        black_box(&sdu);
    }
    Ok(us_each(start, SDUS))
}

/// Returns the microseconds that the two sides of a key agreement take together.
fn agreement_us() -> Result<f64, Box<dyn Error>> {
    let secret =
        Secret::new(b"fleet:a secret of the team, long enough").ok_or("the secret is too short")?;
    let start = Instant::now();
    for _ in 0..AGREEMENTS {
        let (initiator, message) = Initiator::start(&secret, b"header")?;
        let (answer, _) = respond(&secret, b"header", &message)?;
        black_box(initiator.finish(&answer)?);
    }
    Ok(us_each(start, AGREEMENTS))
}

fn us_each(start: Instant, count: u32) -> f64 {
    start.elapsed().as_secs_f64() * 1e6 / f64::from(count)
}
