import java.io.File;
import javax.xml.XMLConstants;
import javax.xml.transform.stream.StreamSource;
import javax.xml.validation.SchemaFactory;

/** Validates a file by a schema: exits with 0, or says what is wrong and where. */
public class Validate {
  public static void main(String[] arguments) throws Exception {
    var schemas = SchemaFactory.newInstance(XMLConstants.W3C_XML_SCHEMA_NS_URI);
    var schema = schemas.newSchema(new File(arguments[0]));
    schema.newValidator().validate(new StreamSource(new File(arguments[1])));
  }
}
