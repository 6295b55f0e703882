/* SPDX-License-Identifier: MIT
 * Reads and writes still pictures through OpenImageIO. No exception and no C++ type leaves this file. A file is encoded
 * in memory and written by io/file, so that a full disk is reported. */
#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <cstring>
#include <exception>
#include <memory>
#include <new>
#include <string>
#include <vector>

extern "C" {
#include "core/floats.h"
#include "core/memory.h"
#include "io/file.h"
#include "media/image.h"
#include "media/input.h"
#include "media/provenance.h"
}

namespace {

/* The text as one line, without line breaks; "no reason given" where there is none. */
std::string one_line(std::string text) {
  for (char &letter : text) {
    if (letter == '\n' || letter == '\r') letter = ' ';
  }
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text.empty() ? "no reason given" : text;
}

/* Runs `work` and turns an exception into a status. */
template <typename Work>
ern_status guarded(ern_context *context, const char *path, Work work) {
  try {
    return work();
  } catch (const std::bad_alloc &) {
    return ern_fail(context, ERN_E_NO_MEMORY, "%s: no memory for the picture", path);
  } catch (const std::exception &error) {
    return ern_fail(context, ERN_E_MEDIA, "%s: OpenImageIO: %s", path, error.what());
  } catch (...) {
    return ern_fail(context, ERN_E_MEDIA, "%s: OpenImageIO failed and gave no reason", path);
  }
}

/* For formats that ern_image_check_head does not parse: refuses a file that claims more than a row of pixels for each
 * byte. */
ern_status check_claim(ern_context *context, const char *path, const OIIO::ImageSpec &spec) {
  const uint64_t most_per_byte = 4 * ERN_IMAGE_MAX_SIDE, bytes = OIIO::Filesystem::file_size(path);
  const uint64_t claimed = static_cast<uint64_t>(spec.width) * static_cast<uint64_t>(spec.height) *
                           static_cast<uint64_t>(spec.nchannels < 4 ? spec.nchannels : 4);
  if (claimed / most_per_byte <= bytes) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT,
                  "%s: picture claims %d x %d pixels, found %llu bytes: more than a picture can be compressed", path,
                  spec.width, spec.height, static_cast<unsigned long long>(bytes));
}

/* Opens a picture by its content and checks its header. OpenImageIO would parse parts of a name as options or as a
 * video, so this function chooses the reader. Unassociated alpha stays so, except that of a WebP. */
ern_status open_picture(ern_context *context, const char *path, bool for_pixels,
                        std::unique_ptr<OIIO::ImageInput> &input) {
  const char *format = "";
  ern_status status = ern_input_check(context, path);
  if (status == ERN_OK) status = ern_image_check_head(context, path, &format);
  if (status == ERN_OK) status = ern_image_check_png_whole(context, path, for_pixels);
  if (status != ERN_OK) return status;
  OIIO::ImageSpec config, opened;
  config.attribute("oiio:UnassociatedAlpha", 1);
  input = OIIO::ImageInput::create(format);
  if (!input || !input->open(path, opened, config)) {
    const std::string reason = input ? input->geterror() : OIIO::geterror();
    input.reset();
    return ern_fail(context, ERN_E_FORMAT, "%s: is not a picture that can be read: %s", path, one_line(reason).c_str());
  }
  const OIIO::ImageSpec &spec = input->spec();
  if (spec.get_int_attribute("oiio:Movie") != 0) {
    return ern_fail(context, ERN_E_FORMAT, "%s: is a video (%s), expected a still picture", path, input->format_name());
  }
  if (spec.deep || spec.nchannels < 1 || spec.depth > 1) {
    return ern_fail(context, ERN_E_UNSUPPORTED, "%s: has %d channels%s, expected a flat picture", path, spec.nchannels,
                    spec.deep ? " of deep samples" : "");
  }
  status = ern_image_check_sides(context, path, spec.width, spec.height);
  return status == ERN_OK ? check_claim(context, path, spec) : status;
}

/* Decodes the first `stored` channels into `pixels` [height][width][stored]. */
ern_status decode(ern_context *context, const char *path, OIIO::ImageInput &input, int stored, uint8_t *pixels) {
  const bool done = input.read_image(0, 0, 0, stored, OIIO::TypeDesc::UINT8, pixels);
  if (done && !input.has_error()) return ERN_OK;
  return ern_fail(context, ERN_E_FORMAT, "%s: the picture is damaged or cut short: %s", path,
                  one_line(input.geterror()).c_str());
}

/* Converts each pixel from `stored` to 3 or 4 channels: grey is repeated; `alpha` is the alpha channel's index, -1:
 * alpha is 255. */
void spread(const uint8_t *from, int stored, int alpha, size_t pixels, int channels, uint8_t *to) {
  const int green = stored >= 3 ? 1 : 0, blue = stored >= 3 ? 2 : 0;
  for (size_t i = 0; i < pixels; i++, from += stored, to += channels) {
    to[0] = from[0];
    to[1] = from[green];
    to[2] = from[blue];
    if (channels == 4) to[3] = alpha >= 0 ? from[alpha] : 255;
  }
}

/* Divides colours that are multiplied by alpha: c = round(255 c'/alpha), at most 255. */
void divide_by_alpha(uint8_t *pixel, int stored, int alpha, size_t pixels) {
  for (size_t i = 0; i < pixels; i++, pixel += stored) {
    const int share = pixel[alpha];
    for (int c = 0; c < stored && share > 0; c++) {
      const int value = (255 * pixel[c] + share / 2) / share;
      if (c != alpha) pixel[c] = static_cast<uint8_t>(value < 255 ? value : 255);
    }
  }
}

/* EXIF's orientation, 1 (upright) to 8; 1 where the file has none. From 5 on, rows are stored as columns. */
int orientation_of(const OIIO::ImageSpec &spec) {
  const int orientation = spec.get_int_attribute("Orientation", 1);
  return orientation >= 1 && orientation <= 8 ? orientation : 1;
}

/* *image = the pixels as they are stored. */
ern_status read_stored(ern_context *context, const char *path, OIIO::ImageInput &input, int channels,
                       ern_image *image) {
  const OIIO::ImageSpec &spec = input.spec();
  const int stored = spec.nchannels < 4 ? spec.nchannels : 4;
  const int alpha = spec.alpha_channel < stored ? spec.alpha_channel : -1;
  /* OpenEXR, and a TIFF that says so; OpenImageIO multiplies the colours of a WebP itself */
  const bool multiplied = alpha >= 0 && spec.get_int_attribute("oiio:UnassociatedAlpha") == 0 &&
                          (std::strcmp(input.format_name(), "tiff") != 0 || ern_image_tiff_is_multiplied(path));
  ern_status status = ern_image_make(context, path, spec.width, spec.height, channels, image);
  if (status != ERN_OK) return status;
  if (!multiplied && stored == channels && (channels == 3 || alpha == 3))
    return decode(context, path, input, stored, image->data);
  const size_t pixels = static_cast<size_t>(spec.width) * static_cast<size_t>(spec.height);
  std::vector<uint8_t> raw(pixels * static_cast<size_t>(stored));
  status = decode(context, path, input, stored, raw.data());
  if (multiplied && status == ERN_OK) divide_by_alpha(raw.data(), stored, alpha, pixels);
  if (status == ERN_OK) spread(raw.data(), stored, alpha, pixels, channels, image->data);
  return status;
}

/* OpenImageIO does not hand out the profile of a WebP: a chunk (name, 4 bytes of size, little end first, that many
 * bytes, filled to an even number) after "RIFF", the file's size and "WEBP". */
ern_status apply_webp_profile(ern_context *context, const char *path, ern_image *image) {
  uint8_t *bytes = nullptr;
  size_t count = 0;
  ern_status status = ern_file_read(context, path, size_t{1} << 28, &bytes, &count);
  for (size_t at = 12; status == ERN_OK && at + 8 <= count;) {
    const uint8_t *chunk = bytes + at;
    const size_t size = chunk[4] | static_cast<size_t>(chunk[5]) << 8 | static_cast<size_t>(chunk[6]) << 16 |
                        static_cast<size_t>(chunk[7]) << 24;
    if (size > count - at - 8) break;
    if (std::memcmp(chunk, "ICCP", 4) == 0) {
      status = ern_colour_profile_apply(context, path, chunk + 8, size, image);
      break;
    }
    at += 8 + size + size % 2;
  }
  ern_release(context, bytes);
  return status;
}

/* The colours become those of sRGB, or a warning says that they are taken as those. */
ern_status become_srgb(ern_context *context, const char *path, const OIIO::ImageInput &input, ern_image *image) {
  const OIIO::ImageSpec &spec = input.spec();
  if (std::strcmp(input.format_name(), "webp") == 0) return apply_webp_profile(context, path, image);
  const OIIO::ParamValue *profile = spec.find_attribute("ICCProfile");
  if (profile != nullptr)
    return ern_colour_profile_apply(context, path, static_cast<const uint8_t *>(profile->data()),
                                    static_cast<size_t>(profile->datasize()), image);
  const bool png = std::strcmp(input.format_name(), "png") == 0;
  const char *chunk = png ? ern_image_png_other_colours(path) : nullptr;
  const double gamma = static_cast<double>(spec.get_float_attribute("oiio:Gamma", 2.2F)); /* of a PNG that states one */
  if (chunk != nullptr)
    ern_log(context, ERN_LOG_WARNING,
            "%s: says in its chunk %s that its colours are not those of sRGB; they are taken as sRGB", path, chunk);
  else if (gamma < 1.9 || gamma > 2.4) /* 1.96: a frame of a BT.709 video, as FFmpeg writes it */
    ern_log(context, ERN_LOG_WARNING,
            "%s: says that its colours have a gamma of %.3g; they are taken as sRGB, about 2.2", path, gamma);
  if (spec.get_int_attribute("Exif:ColorSpace", 1) == 65535)
    ern_log(context, ERN_LOG_WARNING,
            "%s: says that its colours are not those of sRGB, such as Adobe RGB, but has no colour profile; they are "
            "taken as sRGB",
            path);
  return ERN_OK;
}

ern_status read_pixels(ern_context *context, const char *path, int channels, ern_image *image) {
  std::unique_ptr<OIIO::ImageInput> input;
  ern_image turned = {};
  ern_status status = open_picture(context, path, true, input);
  if (status != ERN_OK) return status;
  const int orientation = orientation_of(input->spec());
  status = read_stored(context, path, *input, channels, image);
  if (status == ERN_OK) status = become_srgb(context, path, *input, image);
  if (status != ERN_OK || orientation == 1) return status;
  status = ern_image_turn(context, path, image, orientation, &turned);
  ern_image_free(context, image);
  *image = turned;
  return status;
}

bool ends_with(const std::string &text, const char *ending) {
  const size_t length = std::strlen(ending);
  return text.size() > length && text.compare(text.size() - length, length, ending) == 0;
}

/* "png", "jpeg", or NULL: by the extension, ignoring case. */
const char *format_of(const char *path) {
  std::string lower(path);
  for (char &letter : lower) {
    if (letter >= 'A' && letter <= 'Z') letter = static_cast<char>(letter - 'A' + 'a');
  }
  if (ends_with(lower, ".png")) return "png";
  if (ends_with(lower, ".jpg") || ends_with(lower, ".jpeg")) return "jpeg";
  return nullptr;
}

/* Encodes pixels of `type` as `format` and writes the bytes to `path`. */
ern_status encode(ern_context *context, const char *path, const char *format, const OIIO::ImageSpec &spec,
                  OIIO::TypeDesc type, const void *pixels, const char *xmp) {
  std::unique_ptr<OIIO::ImageOutput> output = OIIO::ImageOutput::create(format);
  if (!output) {
    return ern_fail(context, ERN_E_MEDIA, "%s: OpenImageIO cannot write %s: %s", path, format,
                    one_line(OIIO::geterror()).c_str());
  }
  OIIO::Filesystem::IOVecOutput memory;
  /* the name has no effect; it must not be `path`, whose file must stay untouched yet */
  const bool done = output->set_ioproxy(&memory) && output->open(std::string("picture.") + format, spec) &&
                    output->write_image(type, pixels) && output->close();
  if (!done || output->has_error()) {
    return ern_fail(context, ERN_E_MEDIA, "%s: cannot encode %d x %d pixels as %s: %s", path, spec.width, spec.height,
                    format, one_line(output->geterror()).c_str());
  }
  const uint8_t *bytes = memory.buffer().data();
  size_t count = memory.buffer().size();
  uint8_t *with = nullptr;
  ern_status status = ERN_OK;
  if (xmp != nullptr) {
    status = ern_provenance_insert(context, xmp, bytes, count, &with, &count);
    bytes = with;
  }
  if (status == ERN_OK) status = ern_file_write(context, path, bytes, count, ERN_EXISTING_BY_CONTEXT);
  ern_release(context, with);
  return status;
}

ern_status write_pixels(ern_context *context, const char *path, const char *format, const ern_image *image, int quality,
                        const char *xmp) {
  OIIO::ImageSpec spec(image->width, image->height, image->channels, OIIO::TypeDesc::UINT8);
  if (image->channels == 4) spec.attribute("oiio:UnassociatedAlpha", 1);
  spec.attribute("png:compressionLevel", 4); /* half the time of the default for a twentieth more bytes */
  if (std::strcmp(format, "jpeg") == 0) {
    spec.attribute("Compression", std::string("jpeg:") + std::to_string(quality));
    spec.attribute("jpeg:subsampling", quality >= 95 ? "4:4:4" : "4:2:0");
  }
  return encode(context, path, format, spec, OIIO::TypeDesc::UINT8, image->data, xmp);
}

ern_status write_floats(ern_context *context, const char *path, const float *data, int width, int height, int channels,
                        const char *const *names, const char *xmp) {
  OIIO::ImageSpec spec(width, height, channels, OIIO::TypeDesc::FLOAT);
  spec.alpha_channel = spec.z_channel = -1;
  for (int i = 0; i < channels; i++) {
    spec.channelnames[static_cast<size_t>(i)] = names[i];
    if (std::strcmp(names[i], "A") == 0) spec.alpha_channel = i;
    if (std::strcmp(names[i], "Z") == 0) spec.z_channel = i;
  }
  spec.attribute("compression", "zip");
  spec.attribute("DateTime", "1970:01:01 00:00:00"); /* fixed: same picture, same bytes */
  if (xmp != nullptr) spec.attribute("xmp", xmp);
  return encode(context, path, "openexr", spec, OIIO::TypeDesc::FLOAT, data, nullptr);
}

}  // namespace

extern "C" ern_status ern_image_read(ern_context *context, const char *path, int channels, ern_image *image) {
  ERN_PLAIN_FLOATS;
  if (image != nullptr) *image = ern_image{};
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, image);
  if (channels != 3 && channels != 4) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: %d channels were asked for, expected 3 or 4", path, channels);
  }
  const ern_status status = guarded(context, path, [&] { return read_pixels(context, path, channels, image); });
  if (status != ERN_OK) ern_image_free(context, image);
  return status;
}

extern "C" ern_status ern_image_size(ern_context *context, const char *path, int *width, int *height) {
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, width);
  ERN_NEED(context, height);
  *width = *height = 0;
  return guarded(context, path, [&] {
    std::unique_ptr<OIIO::ImageInput> opened;
    const ern_status status = open_picture(context, path, false, opened);
    if (status == ERN_OK) {
      const OIIO::ImageSpec &spec = opened->spec();
      const bool swapped = orientation_of(spec) >= 5;
      *width = swapped ? spec.height : spec.width;
      *height = swapped ? spec.width : spec.height;
    }
    return status;
  });
}

extern "C" ern_status ern_image_write(ern_context *context, const char *path, const ern_image *image, int quality) {
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, image);
  return ern_image_write_provenance(context, path, image, quality, nullptr);
}

extern "C" ern_status ern_image_write_provenance(ern_context *context, const char *path, const ern_image *image,
                                                 int quality, const ern_provenance *provenance) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, image);
  ern_status status = ern_file_check_output(context, path);
  if (status == ERN_OK) status = ern_image_check(context, path, image);
  if (status != ERN_OK) return status;
  const char *format = format_of(path);
  if (format == nullptr) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: the extension names no known format, expected .png or .jpg", path);
  }
  if (std::strcmp(format, "jpeg") == 0) {
    if (image->channels == 4) {
      return ern_fail(context, ERN_E_ARGUMENT, "%s: JPEG has no alpha, expected 1 or 3 channels or .png", path);
    }
    if (quality < 1 || quality > 100) {
      return ern_fail(context, ERN_E_ARGUMENT, "%s: quality is %d, expected 1 to 100", path, quality);
    }
  }
  ern_provenance_texts texts;
  status = ern_provenance_texts_make(context, provenance, &texts);
  if (status != ERN_OK) return status;
  status = guarded(context, path, [&] { return write_pixels(context, path, format, image, quality, texts.xmp); });
  ern_provenance_texts_free(context, &texts);
  return status;
}

extern "C" ern_status ern_image_write_exr(ern_context *context, const char *path, const float *data, int width,
                                          int height, int channels, const char *const *names) {
  ERN_NEED(context, context);
  return ern_image_write_exr_provenance(context, path, data, width, height, channels, names, nullptr);
}

extern "C" ern_status ern_image_write_exr_provenance(ern_context *context, const char *path, const float *data,
                                                     int width, int height, int channels, const char *const *names,
                                                     const ern_provenance *provenance) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, path);
  ERN_NEED(context, data);
  ERN_NEED(context, names);
  ern_status status = ern_image_check_sides(context, path, width, height);
  if (status != ERN_OK) return status;
  if (channels < 1 || channels > 64) {
    return ern_fail(context, ERN_E_ARGUMENT, "%s: %d channels, expected 1 to 64", path, channels);
  }
  for (int i = 0; i < channels; i++) {
    if (names[i] == nullptr || names[i][0] == 0) {
      return ern_fail(context, ERN_E_ARGUMENT, "%s: channel %d has no name", path, i);
    }
    for (int j = 0; j < i; j++) {
      if (std::strcmp(names[i], names[j]) != 0) continue;
      return ern_fail(context, ERN_E_ARGUMENT, "%s: channels %d and %d are both named \"%s\"", path, j, i, names[i]);
    }
  }
  ern_provenance_texts texts;
  status = ern_provenance_texts_make(context, provenance, &texts);
  if (status != ERN_OK) return status;
  status = guarded(context, path,
                   [&] { return write_floats(context, path, data, width, height, channels, names, texts.xmp); });
  ern_provenance_texts_free(context, &texts);
  return status;
}
