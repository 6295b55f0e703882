/* SPDX-License-Identifier: MIT
 * Provenance metadata: XMP (ISO 16684-1) with IPTC's DigitalSourceType (Photo Metadata Standard 2023.2) and the label
 * of GB 45438-2025. */
#include "media/provenance.h"

#include <libavutil/crc.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/memory.h"
#include "core/sized.h"
#include "io/file.h"

enum { ESCAPE_MOST = 5 /* most bytes that escaping makes of a byte */, MOST_ID = 128 };

/* ---- texts ------------------------------------------------------------------------------------------------------- */

/* Bytes of the UTF-8 character at `text` (RFC 3629), 0 where there is none. */
static size_t character_bytes(const char *text) {
  const unsigned char *at = (const unsigned char *)text;
  const size_t count = at[0] < 0x80 ? 1 : at[0] < 0xc2 ? 0 : at[0] < 0xe0 ? 2 : at[0] < 0xf0 ? 3 : at[0] < 0xf5 ? 4 : 0;
  for (size_t i = 1; i < count; i++)
    if ((at[i] & 0xc0) != 0x80) return 0; /* also at the text's end */
  const bool is_long = (at[0] == 0xe0 && at[1] < 0xa0) || (at[0] == 0xf0 && at[1] < 0x90);
  const bool beyond = (at[0] == 0xed && at[1] >= 0xa0) || (at[0] == 0xf4 && at[1] >= 0x90);
  return is_long || beyond ? 0 : count;
}

static ern_status check_text(ern_context *context, const char *text, const char *what) {
  for (size_t at = 0, bytes = 1; text[at] != 0; at += bytes) {
    bytes = character_bytes(text + at);
    if (bytes == 0 || at + bytes >= ERN_CONSENT_BYTES)
      return ern_fail(context, ERN_E_ARGUMENT, "provenance: the %s is %s, expected UTF-8 of at most %d bytes", what,
                      bytes == 0 ? "no UTF-8" : "longer", ERN_CONSENT_BYTES - 1);
  }
  return ERN_OK;
}

/* Allows only characters that neither XML nor JSON escapes. */
static ern_status check_id(ern_context *context, const char *id) {
  const size_t plain = strspn(id, "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._:-");
  if (id[plain] == 0 && plain <= MOST_ID) return ERN_OK;
  return ern_fail(context, ERN_E_ARGUMENT,
                  "provenance: the id is \"%.80s\", expected at most %d of A-Z a-z 0-9 . _ : -", id, MOST_ID);
}

/* Escapes text for XML. Control characters, which XML does not allow, become spaces. */
static void escape(const char *text, char *out) {
  for (; *text != 0; text++) {
    const char letter = (unsigned char)*text < 0x20 || *text == 0x7f ? ' ' : *text;
    if (letter == '&')
      out += sprintf(out, "&amp;");
    else if (letter == '<')
      out += sprintf(out, "&lt;");
    else if (letter == '>')
      out += sprintf(out, "&gt;");
    else
      *out++ = letter;
  }
  *out = 0;
}

/* A member of the packet with one text, in the language that is not told; "" for an empty text. The caller owns it. */
static ern_status make_member(ern_context *context, const char *name, const char *text, char **member) {
  static const char form[] = "   <%s><rdf:Alt><rdf:li xml:lang=\"x-default\">%s</rdf:li></rdf:Alt></%s>\n";
  char *escaped = NULL;
  const size_t bytes = sizeof form + 2 * strlen(name) + ESCAPE_MOST * strlen(text);
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, ESCAPE_MOST * strlen(text) + 1, &escaped));
  ERN_TRY(ERN_NEW(context, bytes, member));
  escape(text, escaped);
  if (text[0] != 0) snprintf(*member, bytes, form, name, escaped, name);
fail:
  ern_release(context, escaped);
  return status;
}

/* members: of the packet. */
static ern_status write_texts(ern_context *context, const char *id, const char *const members[2],
                              struct ern_provenance_texts *texts) {
  static const char label[] =
      "{\"Label\":\"1\",\"ContentProducer\":\"libernerf\",\"ProduceID\":\"%s\",\"ReservedCode1\":\"\","
      "\"ContentPropagator\":\"\",\"PropagateID\":\"\",\"ReservedCode2\":\"\"}";
  static const char packet[] =
      "<?xpacket begin=\"\xef\xbb\xbf\" id=\"W5M0MpCehiHzreSzNTczkc9d\"?>\n"
      "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\">\n"
      " <rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\">\n"
      "  <rdf:Description rdf:about=\"\"\n"
      "    xmlns:dc=\"http://purl.org/dc/elements/1.1/\"\n"
      "    xmlns:xmp=\"http://ns.adobe.com/xap/1.0/\"\n"
      "    xmlns:xmpRights=\"http://ns.adobe.com/xap/1.0/rights/\"\n"
      "    xmlns:Iptc4xmpExt=\"http://iptc.org/std/Iptc4xmpExt/2008-02-29/\"\n"
      "    xmlns:TC260=\"http://www.tc260.org.cn/ns/AIGC/1.0/\">\n"
      "   <xmp:CreatorTool>libernerf</xmp:CreatorTool>\n"
      "   <Iptc4xmpExt:DigitalSourceType>%s</Iptc4xmpExt:DigitalSourceType>\n"
      "   <TC260:AIGC>%s</TC260:AIGC>\n"
      "%s%s"
      "  </rdf:Description>\n"
      " </rdf:RDF>\n"
      "</x:xmpmeta>\n"
      "<?xpacket end=\"r\"?>";
  const size_t aigc_bytes = sizeof label + strlen(id);
  const size_t bytes =
      sizeof packet + strlen(texts->source_type) + aigc_bytes + strlen(members[0]) + strlen(members[1]);
  ern_status status = ERN_OK;
  ERN_TRY(ERN_NEW(context, aigc_bytes, &texts->aigc));
  ERN_TRY(ERN_NEW(context, bytes, &texts->xmp));
  snprintf(texts->aigc, aigc_bytes, label, id);
  snprintf(texts->xmp, bytes, packet, texts->source_type, texts->aigc, members[0], members[1]);
fail:
  return status;
}

ern_status ern_provenance_texts_make(ern_context *context, const ern_provenance *provenance,
                                     struct ern_provenance_texts *texts) {
  *texts = (struct ern_provenance_texts){0};
  if (provenance == NULL) return ERN_OK;
  ern_provenance p = ern_provenance_default();
  ern_status status = ERN_OK;
  char *consent = NULL, *description = NULL;
  ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_provenance, &p, provenance));
  if (p.id == NULL) p.id = "";
  if (p.consent == NULL) p.consent = "";
  if (p.description == NULL) p.description = "";
  ERN_TRY(check_id(context, p.id));
  ERN_TRY(check_text(context, p.consent, "consent"));
  ERN_TRY(check_text(context, p.description, "description"));
  ERN_TRY(make_member(context, "xmpRights:UsageTerms", p.consent, &consent));
  ERN_TRY(make_member(context, "dc:description", p.description, &description));
  texts->source_type = p.all_trained
                           ? "http://cv.iptc.org/newscodes/digitalsourcetype/trainedAlgorithmicMedia"
                           : "http://cv.iptc.org/newscodes/digitalsourcetype/compositeWithTrainedAlgorithmicMedia";
  ERN_TRY(ERN_NEW(context, strlen(p.description) + 1, &texts->description));
  memcpy(texts->description, p.description, strlen(p.description) + 1);
  ERN_TRY(write_texts(context, p.id, (const char *const[2]){description, consent}, texts));
fail:
  ern_release(context, consent);
  ern_release(context, description);
  if (status != ERN_OK) ern_provenance_texts_free(context, texts);
  return status;
}

void ern_provenance_texts_free(ern_context *context, struct ern_provenance_texts *texts) {
  ern_release(context, texts->aigc);
  ern_release(context, texts->description);
  ern_release(context, texts->xmp);
  *texts = (struct ern_provenance_texts){0};
}

/* ---- places in files --------------------------------------------------------------------------------------------- */

static uint8_t *put_be32(uint8_t *to, size_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) *to++ = (uint8_t)(value >> shift);
  return to;
}

/* Inserts an iTXt chunk after IHDR, the first chunk of a PNG, or an APP1 segment after SOI of a JPEG. */
ern_status ern_provenance_insert(ern_context *context, const char *xmp, const uint8_t *bytes, size_t count,
                                 uint8_t **with, size_t *grown) {
  static const char png_head[] = "iTXtXML:com.adobe.xmp\0\0\0\0", jpeg_head[] = "http://ns.adobe.com/xap/1.0/";
  const bool png = bytes[0] == 0x89;
  const size_t place = png ? 33 : 2, text = strlen(xmp), head = png ? sizeof png_head : sizeof jpeg_head;
  const size_t more = png ? 4 + head + text + 4 : 4 + head + text;
  const ern_status status = ERN_NEW(context, count + more, with);
  if (status != ERN_OK) return status;
  uint8_t *to = *with;
  memcpy(to, bytes, place);
  to += place;
  if (png) { /* length, type, "XML:com.adobe.xmp", 0, not compressed (0, 0), no language 0, no translation 0, text */
    to = put_be32(to, head - 4 + text);
    memcpy(to, png_head, head);
    memcpy(to + head, xmp, text);
    const uint32_t sum = av_crc(av_crc_get_table(AV_CRC_32_IEEE_LE), UINT32_MAX, to, head + text) ^ UINT32_MAX;
    to = put_be32(to + head + text, sum);
  } else { /* FF E1, length with its own two bytes, the namespace and its 0, text */
    *to++ = 0xff;
    *to++ = 0xe1;
    *to++ = (uint8_t)((2 + head + text) >> 8);
    *to++ = (uint8_t)(2 + head + text);
    memcpy(to, jpeg_head, head);
    memcpy(to + head, xmp, text);
    to += head + text;
  }
  memcpy(to, bytes + place, count - place);
  *grown = count + more;
  return ERN_OK;
}

ern_status ern_provenance_box(ern_context *context, const char *xmp, uint8_t **box, size_t *count) {
  /* XMP specification, part 3: the UUID of its box in ISO base media files */
  static const uint8_t uuid[16] = {0xbe, 0x7a, 0xcf, 0xcb, 0x97, 0xa9, 0x42, 0xe8,
                                   0x9c, 0x71, 0x99, 0x94, 0x91, 0xe3, 0xaf, 0xac};
  *count = 8 + sizeof uuid + strlen(xmp);
  const ern_status status = ERN_NEW(context, *count, box);
  if (status != ERN_OK) return status;
  memcpy(put_be32(*box, *count), "uuid", 4);
  memcpy(*box + 8, uuid, sizeof uuid);
  memcpy(*box + 8 + sizeof uuid, xmp, strlen(xmp));
  return ERN_OK;
}

ern_status ern_provenance_extension(ern_context *context, const char *xmp, uint8_t **extension, size_t *count) {
  /* GIF89a, 26; XMP specification, part 3: readers that skip sub-blocks interpret the packet's letters as lengths; the
   * bytes 255 down to 0 after the packet lead any of them to the end */
  static const char head[] = "\x21\xff\x0bXMP DataXMP";
  enum { HEAD = sizeof head - 1, NUMBERS = 256 };
  const size_t text = strlen(xmp);
  *count = HEAD + text + 1 + NUMBERS + 1 + 1;
  const ern_status status = ERN_NEW(context, *count, extension);
  if (status != ERN_OK) return status;
  uint8_t *to = *extension;
  memcpy(to, head, HEAD);
  memcpy(to + HEAD, xmp, text);
  to += HEAD + text;
  *to++ = 1;
  for (int i = 0; i < NUMBERS; i++) *to++ = (uint8_t)(NUMBERS - 1 - i);
  *to++ = 0;
  *to = 0x3b; /* the file's trailer */
  return ERN_OK;
}
