package valvemap;

import static org.eclipse.milo.opcua.stack.core.types.builtin.unsigned.Unsigned.uint;

import com.google.gson.JsonObject;
import java.io.ByteArrayInputStream;
import java.nio.file.Files;
import java.nio.file.Path;
import java.security.KeyFactory;
import java.security.KeyPair;
import java.security.PrivateKey;
import java.security.cert.CertificateFactory;
import java.security.cert.X509Certificate;
import java.security.spec.PKCS8EncodedKeySpec;
import java.util.Base64;
import org.bouncycastle.jce.provider.BouncyCastleProvider;
import org.eclipse.milo.opcua.sdk.client.OpcUaClient;
import org.eclipse.milo.opcua.sdk.client.identity.UsernameProvider;
import org.eclipse.milo.opcua.stack.core.StatusCodes;
import org.eclipse.milo.opcua.stack.core.UaException;
import org.eclipse.milo.opcua.stack.core.types.builtin.LocalizedText;

/** Opens a connection with certificates; the server's must be the very one that is expected. */
final class Security {

  private static final String URI = "http://opcfoundation.org/UA/SecurityPolicy#";

  static {
    java.security.Security.addProvider(new BouncyCastleProvider()); // has RSA-PSS as Milo names it
  }

  static OpcUaClient connect(JsonObject step) throws Exception {
    if (!step.has("policy")) {
      return connectOpen(step.get("url").getAsString());
    }
    String policy = URI + step.get("policy").getAsString();
    X509Certificate own = certificate(step.get("certificate").getAsString());
    X509Certificate server = certificate(step.get("server").getAsString());
    KeyPair keys = new KeyPair(own.getPublicKey(), key(step.get("key").getAsString()));
    OpcUaClient client =
        OpcUaClient.create(
            step.get("url").getAsString(),
            endpoints ->
                endpoints.stream().filter(e -> e.getSecurityPolicyUri().equals(policy)).findFirst(),
            transport -> {},
            config ->
                config
                    .setApplicationName(LocalizedText.english("valvemap-milo-client"))
                    .setApplicationUri(step.get("applicationUri").getAsString())
                    .setKeyPair(keys)
                    .setCertificate(own)
                    .setCertificateChain(new X509Certificate[] {own})
                    .setCertificateValidator(
                        (chain, uri, hosts) -> {
                          if (!chain.get(0).equals(server)) {
                            throw new UaException(StatusCodes.Bad_CertificateUntrusted);
                          }
                        })
                    .setIdentityProvider(
                        new UsernameProvider(
                            step.get("user").getAsString(), step.get("password").getAsString()))
                    .setRequestTimeout(uint(5_000)));
    try {
      client.connect();
    } catch (UaException error) {
      client.disconnect();
      throw error;
    }
    return client;
  }

  private static OpcUaClient connectOpen(String url) throws UaException {
    OpcUaClient client =
        OpcUaClient.create(
            url,
            endpoints ->
                endpoints.stream()
                    .filter(e -> e.getSecurityPolicyUri().equals(URI + "None"))
                    .findFirst(),
            transport -> {},
            config -> config.setRequestTimeout(uint(5_000)));
    client.connect();
    return client;
  }

  private static X509Certificate certificate(String file) throws Exception {
    byte[] content = Files.readAllBytes(Path.of(file));
    return (X509Certificate)
        CertificateFactory.getInstance("X.509")
            .generateCertificate(new ByteArrayInputStream(content));
  }

  private static PrivateKey key(String file) throws Exception {
    String text = Files.readString(Path.of(file)).replaceAll("-----[^-]+-----|\\s", "");
    return KeyFactory.getInstance("RSA")
        .generatePrivate(new PKCS8EncodedKeySpec(Base64.getDecoder().decode(text)));
  }

  private Security() {}
}
