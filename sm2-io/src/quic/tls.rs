//! TLS 1.3 with raw public keys: each side presents its public key, proves that it holds the private
//! key, and accepts no other kind of certificate.

use std::{
    collections::BTreeSet,
    sync::{Arc, PoisonError, RwLock},
};

use quinn_proto::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use rustls::{
    CertificateError, ClientConfig, DigitallySignedStruct, DistinguishedName, Error,
    PeerIncompatible, ServerConfig, SignatureScheme,
    client::{
        AlwaysResolvesClientRawPublicKeys,
        danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
    },
    crypto::{
        CryptoProvider, WebPkiSupportedAlgorithms, ring::default_provider,
        ring::sign::any_eddsa_type, verify_tls13_signature_with_raw_key,
    },
    pki_types::{
        CertificateDer, PrivateKeyDer, PrivatePkcs8KeyDer, ServerName, SubjectPublicKeyInfoDer,
        UnixTime,
    },
    server::{
        AlwaysResolvesServerRawPublicKeys,
        danger::{ClientCertVerified, ClientCertVerifier},
    },
    sign::CertifiedKey,
    version::TLS13,
};
use sm2_proto::gateway::GatewayId;

use super::{
    key::{SecretKey, from_spki, to_spki},
    transport::ALPN,
};

/// The gateways whose keys are trusted now. Each handshake consults the current set.
#[derive(Clone, Debug, Default)]
pub struct Trusted(Arc<RwLock<BTreeSet<GatewayId>>>);

impl Trusted {
    /// Replaces the set: only these gateways are trusted from now on.
    pub fn set(&self, peers: impl IntoIterator<Item = GatewayId>) {
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = peers.into_iter().collect();
    }

    fn holds(&self, peer: GatewayId) -> bool {
        let peers = self.0.read().unwrap_or_else(PoisonError::into_inner);
        peers.contains(&peer)
    }
}

/// The gateways that may be at the other end.
#[derive(Debug)]
enum Expected {
    /// The gateway that this side dialled, if it is trusted.
    One(GatewayId, Trusted),
    /// Any trusted gateway.
    Any(Trusted),
}

#[derive(Debug)]
struct Verifier {
    expected: Expected,
    algorithms: WebPkiSupportedAlgorithms,
}

impl Verifier {
    fn new(expected: Expected) -> Arc<Self> {
        let algorithms = default_provider().signature_verification_algorithms;
        Arc::new(Self {
            expected,
            algorithms,
        })
    }

    //= SM2-GWC-002
    fn check(&self, shown: &CertificateDer<'_>, more: &[CertificateDer<'_>]) -> Result<(), Error> {
        let peer = from_spki(shown).filter(|_| more.is_empty());
        let peer = peer.ok_or(Error::InvalidCertificate(CertificateError::BadEncoding))?;
        let is_expected = match &self.expected {
            Expected::One(expected, trusted) => peer == *expected && trusted.holds(peer),
            Expected::Any(trusted) => trusted.holds(peer),
        };
        if is_expected {
            Ok(())
        } else {
            let untrusted = CertificateError::ApplicationVerificationFailure;
            Err(Error::InvalidCertificate(untrusted))
        }
    }

    fn check_signature(
        &self,
        message: &[u8],
        key: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let key = SubjectPublicKeyInfoDer::from(key.as_ref());
        verify_tls13_signature_with_raw_key(message, &key, signed, &self.algorithms)
    }
}

/// The answer to signatures of TLS 1.2, which is never negotiated.
fn no_tls12() -> Result<HandshakeSignatureValid, Error> {
    Err(Error::PeerIncompatible(PeerIncompatible::Tls12NotOffered))
}

/// The methods that `ServerCertVerifier` and `ClientCertVerifier` share: signatures of TLS 1.3 by
/// raw Ed25519 keys, and nothing else.
macro_rules! raw_ed25519_keys {
    () => {
        fn verify_tls12_signature(
            &self,
            _message: &[u8],
            _key: &CertificateDer<'_>,
            _signed: &DigitallySignedStruct,
        ) -> Result<HandshakeSignatureValid, Error> {
            no_tls12()
        }

        fn verify_tls13_signature(
            &self,
            message: &[u8],
            key: &CertificateDer<'_>,
            signed: &DigitallySignedStruct,
        ) -> Result<HandshakeSignatureValid, Error> {
            self.check_signature(message, key, signed)
        }

        fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
            vec![SignatureScheme::ED25519]
        }

        fn requires_raw_public_keys(&self) -> bool {
            true
        }
    };
}

impl ServerCertVerifier for Verifier {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        intermediates: &[CertificateDer<'_>],
        _name: &ServerName<'_>,
        _ocsp: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        self.check(end_entity, intermediates)?;
        Ok(ServerCertVerified::assertion())
    }

    raw_ed25519_keys!();
}

impl ClientCertVerifier for Verifier {
    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        intermediates: &[CertificateDer<'_>],
        _now: UnixTime,
    ) -> Result<ClientCertVerified, Error> {
        self.check(end_entity, intermediates)?;
        Ok(ClientCertVerified::assertion())
    }

    raw_ed25519_keys!();
}

fn provider() -> Arc<CryptoProvider> {
    Arc::new(default_provider())
}

fn certified(key: &SecretKey) -> Result<Arc<CertifiedKey>, Error> {
    let private = PrivateKeyDer::Pkcs8(PrivatePkcs8KeyDer::from(key.to_pkcs8().to_vec()));
    let signing = any_eddsa_type(match &private {
        PrivateKeyDer::Pkcs8(it) => it,
        _ => return Err(Error::General("not PKCS#8".into())),
    })?;
    let shown = CertificateDer::from(to_spki(key.id()));
    Ok(Arc::new(CertifiedKey::new(vec![shown], signing)))
}

/// The configuration for incoming connections.
pub(super) fn server(key: &SecretKey, trusted: &Trusted) -> Result<QuicServerConfig, Error> {
    let mut config = ServerConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&TLS13])?
        .with_client_cert_verifier(Verifier::new(Expected::Any(trusted.clone())))
        .with_cert_resolver(Arc::new(AlwaysResolvesServerRawPublicKeys::new(certified(
            key,
        )?)));
    config.alpn_protocols = vec![ALPN.to_vec()];
    config.max_early_data_size = 0;
    // No session resumption: each handshake proves the keys again.
    config.send_tls13_tickets = 0;
    QuicServerConfig::try_from(config).map_err(|error| Error::General(error.to_string()))
}

/// The configuration for a connection that this side opens to `peer`.
pub(super) fn client(
    key: &SecretKey,
    peer: GatewayId,
    trusted: &Trusted,
) -> Result<QuicClientConfig, Error> {
    let expected = Expected::One(peer, trusted.clone());
    let mut config = ClientConfig::builder_with_provider(provider())
        .with_protocol_versions(&[&TLS13])?
        .dangerous()
        .with_custom_certificate_verifier(Verifier::new(expected))
        .with_client_cert_resolver(Arc::new(AlwaysResolvesClientRawPublicKeys::new(certified(
            key,
        )?)));
    config.alpn_protocols = vec![ALPN.to_vec()];
    config.enable_early_data = false;
    config.enable_sni = false;
    config.resumption = rustls::client::Resumption::disabled();
    QuicClientConfig::try_from(config).map_err(|error| Error::General(error.to_string()))
}
