//! The TLS identities that a client can present.

use std::sync::Arc;

use ring::signature::Ed25519KeyPair;
use rustls::{
    ClientConfig, DigitallySignedStruct, Error, SignatureScheme,
    client::{
        AlwaysResolvesClientRawPublicKeys,
        danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    },
    crypto::ring::{default_provider, sign::any_eddsa_type},
    pki_types::{CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, ServerName, UnixTime},
    sign::CertifiedKey,
};
use sm2_io::quic::{ALPN, SecretKey};

/// The identity that a client presents.
pub(crate) enum Shown<'a> {
    Nothing,
    Key(&'a SecretKey),
    /// An X.509 certificate for the key.
    Certificate(&'a SecretKey),
}

/// TLS settings that accept any identity of the gateway.
pub(crate) fn tls(shown: &Shown<'_>, alpn: Option<&[u8]>) -> ClientConfig {
    let builder = ClientConfig::builder_with_provider(Arc::new(default_provider()))
        .with_protocol_versions(&[&rustls::version::TLS13])
        .unwrap()
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(Anybody));
    let mut config = match shown {
        Shown::Nothing => builder.with_no_client_auth(),
        Shown::Key(key) => {
            let signing = any_eddsa_type(&private(key)).unwrap();
            let shown = CertificateDer::from(spki(key));
            let key = Arc::new(CertifiedKey::new(vec![shown], signing));
            builder.with_client_cert_resolver(Arc::new(AlwaysResolvesClientRawPublicKeys::new(key)))
        }
        Shown::Certificate(key) => {
            let chain = vec![CertificateDer::from(certificate(key))];
            let private = PrivateKeyDer::Pkcs8(private(key));
            builder.with_client_auth_cert(chain, private).unwrap()
        }
    };
    config.alpn_protocols = alpn.map(<[u8]>::to_vec).into_iter().collect();
    config.enable_sni = false;
    config
}

/// The TLS settings of an honest peer.
pub(crate) fn honest_tls(key: &SecretKey) -> ClientConfig {
    tls(&Shown::Key(key), Some(ALPN))
}

fn private(key: &SecretKey) -> PrivatePkcs8KeyDer<'static> {
    PrivatePkcs8KeyDer::from(key.to_pkcs8().to_vec())
}

fn spki(key: &SecretKey) -> Vec<u8> {
    let bits = [&[0][..], &key.id().0].concat();
    der(0x30, &[&algorithm(), &der(0x03, &[&bits])])
}

/// The algorithm identifier of Ed25519 (RFC 8410).
fn algorithm() -> Vec<u8> {
    der(0x30, &[&der(0x06, &[&[0x2b, 0x65, 0x70]])])
}

/// A self-signed certificate with an empty subject, valid for a hundred years.
fn certificate(key: &SecretKey) -> Vec<u8> {
    let version = der(0xa0, &[&der(0x02, &[&[2]])]);
    let serial = der(0x02, &[&[1]]);
    let nobody = der(0x30, &[]);
    let validity = der(
        0x30,
        &[
            &der(0x17, &[b"250101000000Z"]),
            &der(0x18, &[b"21250101000000Z"]),
        ],
    );
    let parts = [
        version,
        serial,
        algorithm(),
        nobody.clone(),
        validity,
        nobody,
        spki(key),
    ];
    let signed = der(0x30, &parts.each_ref().map(Vec::as_slice));
    let pair = Ed25519KeyPair::from_pkcs8_maybe_unchecked(key.to_pkcs8()).unwrap();
    let signature = [&[0][..], pair.sign(&signed).as_ref()].concat();
    der(0x30, &[&signed, &algorithm(), &der(0x03, &[&signature])])
}

fn der(tag: u8, parts: &[&[u8]]) -> Vec<u8> {
    let content = parts.concat();
    let len = u16::try_from(content.len()).unwrap().to_be_bytes();
    let head = match len {
        [0, len @ ..0x80] => vec![tag, len],
        [0, len] => vec![tag, 0x81, len],
        [high, low] => vec![tag, 0x82, high, low],
    };
    [head, content].concat()
}

#[derive(Debug)]
struct Anybody;

impl ServerCertVerifier for Anybody {
    fn verify_server_cert(
        &self,
        _end_entity: &CertificateDer<'_>,
        _intermediates: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _key: &CertificateDer<'_>,
        _signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Ok(HandshakeSignatureValid::assertion())
    }

    fn verify_tls13_signature(
        &self,
        _message: &[u8],
        _key: &CertificateDer<'_>,
        _signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        Ok(HandshakeSignatureValid::assertion())
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        vec![SignatureScheme::ED25519]
    }

    fn requires_raw_public_keys(&self) -> bool {
        true
    }
}
