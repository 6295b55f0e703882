/* SPDX-License-Identifier: MIT
 * From frames with poses and speech to a model. base.h defines the terms "plain data", "final" and "may grow". */
#ifndef ERNERF_TRAIN_H
#define ERNERF_TRAIN_H

#include <stdbool.h>

#include "ernerf/backend.h"
#include "ernerf/data.h"
#include "ernerf/model.h"
#include "ernerf/render.h"
#include "ernerf/setting.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- what is trained on ------------------------------------------------------------------------------------------ */

/* The library owns it and sets it to zero before the callback, which fills in what it knows. Plain data, may grow. */
typedef struct ern_dataset_frame {
  float matrix[16];   /* camera to world, row-major, as in a transforms file (ern_pose) */
  int64_t aud_id;     /* index of its window of the features (25 a second), >= 0; past the end: the last one */
  float eye;          /* 0 open .. 1 closed */
  bool has_face;      /* `face` is known */
  ern_box face;       /* box of the landmarks in pixels, as the next three. left, top: their minima; right, bottom:
                         their maxima; each truncated to an integer. Unused without has_face */
  ern_box lower_face; /* from the base of the nose to the chin; its part outside of the picture is ignored, and one
                         without a pixel counts as unknown */
  ern_box lips;   /* likewise, of the mouth's landmarks: where every second step of the fine stage has its patches; its
                     middle is used where ern_train_config.voice_fade is true */
  ern_box eyes;   /* likewise, of both eyes with their lids; used where the dataset has eye values; its middle, as that
                     of the lips */
  ern_box dubbed; /* what ern_dub_frame may draw of the head, likewise */
  float torso_motion[ERN_MOTION_VALUES]; /* of the body, as of ern_frame_input; used where ern_dataset.has_torso_motion
                                            is true */
} ern_dataset_frame;

/* Which pixels of a frame the rays of a step go through. A torso's are uniform in any case. */
typedef enum ern_ray_sampling {
  ERN_RAY_SAMPLING_UNIFORM, /* each as likely as another: the paper's own */
  ERN_RAY_SAMPLING_REGIONS, /* of a head: 30 of 100 in the lower face; 10 around the eyes, if the dataset has eye
                               values; 20 in pixels that ern_dataset.head does not give 0, and 10 in those that it gives
                               neither 0 nor 255; the others, and those of a region that is not known, anywhere.
                               Frames with shut eyes are sampled more often (docs/maths.md) */
  ERN_RAY_SAMPLING_DUB      /* of a head for ern_dub_frame (media.h): 40 of 100 in the lower face, 55 in
                               ern_dataset_frame.dubbed, the others, and those of a region that is not known, anywhere.
                               The even patches of a fine stage and the PSNR of validations are of `dubbed` too */
} ern_ray_sampling;
ERN_API const char *ern_ray_sampling_name(ern_ray_sampling sampling); /* "uniform", "regions", "dub"; else NULL */

#define ERN_SPEECH_NOISE_MOST 10 /* ern_dataset.speech_noise */

/* A clip as the trainer sees it: media's ern_clip_dataset fills one from a folder; a program may fill its own. All
 * pointers must outlive the trainer. ern_trainer_create checks all members, the sizes and values of the features, and
 * `matrix`, `aud_id` and `eye` of each training frame; what the callbacks give later is checked when it is given. An
 * error that a callback returns is passed on. Split 0 is for training, 1 for validation (which may be empty). Callbacks
 * are called in the thread that calls the trainer. Plain data, may grow. */
typedef struct ern_dataset {
  void *user;           /* handed to the callbacks */
  size_t frames[2];     /* number of frames by split; of split 0 at least 1 */
  double focal, cx, cy; /* pixels */
  int width, height;    /* of all pictures, pixels, 1..8192 */
  float scale;          /* factor of the poses' translations, 1e-3..1e3; 4 for clips of ern_prepare and of the public
                           program (model.h); the model keeps it */
  bool has_eye;         /* frames have eye values: a head gets the eye branch */
  bool has_torso;       /* frames have torso pictures: a head is trained over them, and a torso can be trained */
  const ern_features *features; /* the speech */
  const uint8_t *background;    /* [height][width][3], RGB, the top row first, as all pictures here */
  /* Fills *frame, which is all zeros. */
  ern_status (*frame)(void *user, int split, size_t index, ern_dataset_frame *frame);
  /* truth, the recorded picture [height][width][3], RGB; torso [height][width][4], RGBA, alpha not premultiplied, NULL:
   * transparent everywhere; ignored where has_torso is false. The callback's memory, valid until its next call. */
  ern_status (*pixels)(void *user, int split, size_t index, const uint8_t **truth, const uint8_t **torso);
  const char *identity; /* of the clip: 64 hex digits (ern_clip_info); a resume and a torso need the same one. "" or
                           NULL: none */
  /* Data augmentation: [copy_count] versions of the same speech, such as of speakers with other vocal tracts, each of
   * the shape of `features`. With the probability copy_share a training step takes one of them at random, else
   * `features`. */
  const ern_features *copies;
  size_t copy_count;  /* 0: none */
  float copy_share;   /* 0..1 */
  const char *speech; /* kind of the features (ern_model_info.speech), UTF-8 of 63 bytes at most; NULL: it is not known.
                         A torso keeps the kind of its head, and its network */
  const char *speech_network; /* description of the network that made the features (ern_model_info.speech_network); ""
                                 or NULL: none did */
  /* Which pixels of a frame of split 0 are the head's: head [height][width], 255 the head, 0 none of it, any other
   * value not known; head NULL: no pixel is known. The callback's memory, valid until its next call. The callback may
   * be NULL: no pixel of any frame is known. */
  ern_status (*head)(void *user, int split, size_t index, const uint8_t **head);
  float speech_noise; /* data augmentation, 0..ERN_SPEECH_NOISE_MOST: in each training step each number of the speech
                         gets noise. Its standard deviation is speech_noise times that of the same column of `features`
                         over all windows */
  const char *fingerprint; /* of the files of its frames: 64 bytes at most, another text where files were exchanged. A
                              resume warns of another one than the state's, of which a longer one may be the
                              continuation; processes that train one model (ern_communicator) need the same. "" or
                              NULL: it is not known */
  bool has_torso_motion;   /* frames have the motion of the body: a torso is trained with it */
} ern_dataset;

/* ---- trainer ----------------------------------------------------------------------------------------------------- */

/* Number format of the factors in the matrix products of a head's networks, forward and backward. Sums, weights and the
 * optimizer's state are fp32. A step that has the smoothness loss is fp32 throughout. */
typedef enum ern_precision {
  ERN_PRECISION_DEFAULT = 0, /* resuming: as in the state; else fp32 */
  ERN_PRECISION_FP32 = 1,
  ERN_PRECISION_BF16 = 2, /* ERN_E_UNSUPPORTED where it is not possible, see ERN_PRECISION_AUTO */
  ERN_PRECISION_AUTO = 3  /* bf16 where it is possible: where the backend's instruction set is avx512bf16, for a head
                             with the default backbone and attentions; else fp32. A backend of isa "auto" has avx512bf16
                             only where it is faster */
} ern_precision;

#define ERN_FRAMES_PER_STEP_MOST 64 /* ern_train_config.frames_per_step */
#define ERN_FINE_ALL UINT64_MAX     /* ern_train_config.fine_steps */

/* A loss of patches that the program computes, in the place of the structural similarity (media.h has LPIPS).
 * Plain data, final. */
typedef struct ern_fine_loss {
  const char *name; /* of the loss and its network, 1..31 bytes; a training state keeps it */
  /* pixel (rendered), truth (recorded): [3][side][side], planes of red, green, blue; truth is in 0..1. Overwrites *loss
   * and dpixel (d loss/d pixel, of that shape), both without a weight: the trainer multiplies by fine_weight or
   * fine_lips_weight and takes the mean over the patches. Called once a patch, by the thread that calls the trainer. A
   * status other than ERN_OK ends the step with it. Where there is a fine stage, ern_trainer_create calls it once, on a
   * made-up patch; processes that train one model compare the values, and so does a resume with its state
   * (ERN_E_MISMATCH). */
  ern_status (*compute)(void *user, const float *pixel, const float *truth, int side, double *loss, float *dpixel);
  void *user; /* handed to `compute` */
} ern_fine_loss;

#define ERN_COMMUNICATOR_WORDS 512 /* bytes that say why a function failed, with the 0 at their end */

/* Processes that train one model together (ern_train_config.communicator), such as those that mpirun starts. The
 * trainer calls the functions in its caller's thread, in all processes in the same order and with the same counts. A
 * function returns when its result is there. A status other than ERN_OK ends the call of the trainer with that status;
 * `words`, an empty string before, then has the reason, with a 0 at its end. Plain data, final. */
typedef struct ern_communicator {
  void *user; /* handed to the functions */
  int rank;   /* of this process, 0 <= rank < size */
  int size;   /* number of processes, a power of 2 */
  /* Overwrites values[count] (a gradient) and figures[figure_count] (losses) with their sums over the processes. Each
   * sum is that of a binary tree over the ranks, ((0 + 1) + (2 + 3)) + ..., so it has the same bits in each process. */
  ern_status (*sum)(void *user, float *values, size_t count, double *figures, size_t figure_count,
                    char words[ERN_COMMUNICATOR_WORDS]);
  /* values[count]: rank r has set values[count * r/size] to values[count * (r + 1)/size - 1], divisions of integers;
   * afterwards each rank has all. */
  ern_status (*gather)(void *user, float *values, size_t count, char words[ERN_COMMUNICATOR_WORDS]);
  /* Overwrites bytes[count] with those of rank 0. */
  ern_status (*broadcast)(void *user, void *bytes, size_t count, char words[ERN_COMMUNICATOR_WORDS]);
} ern_communicator;

#define ERN_STEP_PARTS_MOST 64 /* ern_train_config.step_parts */

/* Where a comment gives no default, it is 0, false or NULL. Members stand in the order in which they were added;
 * ern_setting.group says which belong together. Plain data, may grow. */
typedef struct ern_train_config {
  uint32_t cookie, size; /* set by ern_train_config_default() */
  bool torso;            /* train the torso of `head` instead of a head */
  const char *output;    /* X: the model file, a name in .safetensors; the folder X.run beside it (without that ending)
                            holds state, log and curve (docs/formats-training.md). NULL: nothing is written */
  bool resume;           /* continue from the newest intact state in X.run, and do not read `from`; where none was saved
                            yet, the training begins at step 0, with a warning in the log. Needs an output */
  bool overwrite;        /* without resume: the first save replaces an earlier training at X and X.run; false: where
                            there is one, ern_trainer_create gives ERN_E_EXISTS */
  const char *from;      /* model file whose weights the training starts from; NULL: random weights. If the file has the
                            optimizer's state, that and its step number are taken too. It must not be a state inside
                            X.run, whose files the saves replace: use `resume` */
  const ern_model *head; /* of a torso: the head that it belongs to, copied; NULL: that of the file `from` */
  uint64_t iters;        /* steps in all, also when resuming, 1..1e12; default 100000 */
  int rays;              /* rays a step, 1..1048576; default 65536 */
  ern_backbone backbone; /* of a head, as the next two; default trihash */
  ern_attention attention;         /* default channel */
  ern_eye_attention eye_attention; /* default sigmoid; `concat` needs a clip with eye values */
  int levels;               /* of a hashed encoder, 2..24; 0 (default): the backbone's own, trihash 14, hash3d 16 */
  bool no_view;             /* of a head: its colour does not depend on the direction of view */
  uint64_t seed;            /* of all random numbers, any value */
  int threads;              /* 0..ERN_THREADS_MOST; 0 (default): one a core that this process may use */
  float lr, lr_net, lr_att; /* learning rates, 0..1e3, of the grids (default 1e-2), the networks (1e-3), and the
                               network that weighs the 8 windows of speech, audio_att_net (5e-3) */
  int codes;        /* rows of the individual codes: -1 (default): one a training frame; 0: no codes; else at least as
                       many as training frames, at most 1e6. With `from`, the first rows are copied from the file; rows
                       that it lacks are initialised. A torso with `head` has as many as that head, but at least
                       one a training frame, and none where the head has none */
  bool torso_gamma; /* train gamma (ern_model_info.has_gamma), as in the paper; false: it is 1 */
  bool torso_random_background; /* true (default): a torso is learnt over a random colour for each ray of each step, so
                                   that its opacity is learnt and it can be rendered over any background; false: over
                                   the clip's background, as published, which leaves the opacity undetermined */
  int max_steps;                /* samples a ray at most, 1..1024; default 16 */
  float dt_gamma;               /* growth of the step along a ray with distance, 0..1; default 1/256 */
  float bound;                  /* of a head (ern_model_info.bound), ERN_BOUND_LEAST..ERN_BOUND_MOST; default 1 */
  float torso_shrink;           /* factor of the torso's coordinates, 0.001..1; default 0.8 */
  ern_audio_pad audio_pad;      /* default edge */
  size_t data_begin, data_end;  /* training frames [begin, end) to use; end 0 (default): all */
  uint64_t save_every;          /* steps between saves; 0: only at the end; default 1000 */
  uint64_t validate_every; /* steps between validations; 0: only at the end; default 1000. Without validation frames the
                              training frame data_begin stands in */
  int validate_frames;     /* most validation frames to render, evenly spaced; 0: all; default 16 */
  bool force;              /* accept a `head` of another clip, with a warning in the log */
  bool ema;                /* write the moving average of the weights as the model. Without `seconds` it needs
                              iters >= 10 ema_every, else ern_trainer_create gives ERN_E_ARGUMENT. Saves before the
                              10th update write the weights without averaging. Validations render what a save would
                              write */
  uint64_t ema_every;      /* steps between its updates, 1..1e12; default 1000 */
  uint64_t refresh_every;  /* steps between refreshes of the occupancy grid, the first before step 0. Above 0: each
                              refresh updates all cells; the paper has 16. 0 (default): the interval is 16 to 128
                              steps (to 64 before step 256), doubled from 16 until interval times `rays` is at least
                              131,072, and after step 256 a refresh updates what is near occupied cells and one
                              sixteenth of the others in turn */
  ern_precision precision; /* default ERN_PRECISION_DEFAULT */
  ern_ray_sampling ray_sampling; /* default regions */
  double seconds; /* 0 (default): train for `iters` steps. Above 0, up to 1e9: stop after the first step that ends past
                     this time, which includes saves, validations and the time of a state that it continues. Learning
                     rates and loss weights then follow the share of the time that has passed instead of step/iters
                     (before a fine stage: of the time up to its beginning). `iters`, `save_every` and `validate_every`
                     are ignored: the trainer saves every minute, and validates at each tenth of the time, at most once
                     a minute. The result cannot be reproduced exactly */
  bool refine_poses;        /* of a head: corrections of the training frames' poses are parameters too, and the model
                               keeps them (ern_model_refine); default false. A resume needs its state's value */
  const char *torso_output; /* of a head with `output`: the model file of the torso that the program will train for this
                               head next; NULL: none. `resume` and `overwrite` apply to it too: ern_trainer_create fails
                               where torso_output cannot be written, and the trainer holds the lock of the .run
                               folder of torso_output until it is freed */
  int frames_per_step;      /* number of frames that share the rays of a step, each with its own speech,
                               1..ERN_FRAMES_PER_STEP_MOST, at most `rays`; default 1, as published. Their gradients are
                               summed */
  uint64_t fine_steps;      /* of a head: this number of steps at the end of `iters`, and at most `iters`, are the fine
                               stage, whose rays are square patches with a loss of their own (docs/maths.md), and those
                               before are the coarse steps; 0 (default): none; ERN_FINE_ALL: all steps from the one on
                               at which the training starts or goes on. A fine stage that is resumed goes on in any
                               case. With `seconds` it must be 0 (ERN_E_ARGUMENT) */
  double fine_share;        /* of a head, with `seconds`: this share of the time, at its end, is the fine stage, 0..1; 0
                               (default): none. Ignored without `seconds` */
  int patch_size;           /* side of a patch, pixels: 16, 32, 48 or 64; default 32. A step of the fine stage has
                               as many patches as `rays` allow, and one at least. Pictures need sides of at least
                               patch_size */
  float fine_weight;        /* of the patches' loss in even steps, whose patches lie anywhere, 0..1e3; default 0.1 */
  float fine_lips_weight; /* of the patches' loss in odd steps, whose patches lie around the lips where these are known,
                             0..1e3; default 0.1. The paper's code has 0.01, with LPIPS */
  const ern_fine_loss *fine_loss; /* NULL (default): structural similarity. The struct and its name are copied, what
                                     `user` points to must outlive the trainer. A resume of a training that has, or
                                     will have, a fine stage must have the same name (ERN_E_MISMATCH) */
  const char *consent; /* what the person who is learnt has agreed to, UTF-8, less than ERN_CONSENT_BYTES. The model
                          keeps it, and pictures and videos of it carry it (ern_provenance). NULL (default): that of the
                          head, of the state that is resumed or of `from`, where it is of this clip, else none */
  float prune_share; /* of a head, 0..1: at 0.85 of the coarse steps a cell of the occupancy grid is marked empty if in
                        every ray its samples have less than this share of the ray's largest compositing weight
                        (docs/maths.md, Occupancy), and, with ern_dataset.head, if it is seen over twice as much beside
                        the head as in it; then the grid stays as it is. The steps after that fit the model to
                        the cells that are left, and rendering has fewer samples. 0 (default): no cell is marked */
  int step_parts;    /* parts that the rays of a step are cut into, a power of 2 up to ERN_STEP_PARTS_MOST; default 1. A
                        part's gradient is summed on its own, and parts are added as a binary tree, so that a model
                        is the same for any number of processes. It must divide `rays` (in a fine stage: the patches
                        of a step), and of it and frames_per_step one must divide the other, else ERN_E_ARGUMENT */
  const ern_communicator *communicator; /* copied; what its `user` points to must outlive the trainer. NULL (default):
                                           this process alone. The processes share the parts of each step, and the
                                           cells of an occupancy refresh: `size` must divide step_parts
                                           (ERN_E_ARGUMENT). Each needs the same data, configuration and backend.
                                           ERN_E_MISMATCH where a rank differs from rank 0 in backend, instruction set,
                                           clip, speech, or a member on which a step depends. Rank
                                           0 alone resumes, reads `from`, validates, saves and calls hooks, and the
                                           others get its state; their `output`, `resume`, `from` and `torso_output`
                                           are ignored */
  bool head_random_background; /* true (default): where ern_dataset.head tells the head from the rest, a ray of a
                                  coarse step has a random colour behind the head, and outside of the head the pixel is
                                  trained to that colour, so that the head's opacity is learnt; false: the clip's
                                  background, as published */
  bool torso_motion; /* true (default): where the dataset has the motion of the body, a torso is trained with it; false:
                        without, as published. A torso that goes on (`resume`, or `from` a file with a torso) is trained
                        as it began */
  bool voice_fade;   /* true (default): speech reaches a head less and less from the base of the nose up, and not at all
                        above the nose (ern_model_info.voice_fade), where the dataset has `lips` and `eyes`; but not with
                        ERN_RAY_SAMPLING_DUB, as a dubbed frame shows nothing above the nose. false: it reaches the whole
                        head, as published. A head that goes on is trained as it began */
} ern_train_config;

/* Description number `index` of the members of ern_train_config after `size`, in their order; NULL past the last. Any
 * thread. */
ERN_API const ern_setting *ern_train_setting(size_t index);

/* The defaults. */
ERN_API void ern_train_config_fill(ern_train_config *config, size_t bytes);
static inline ern_train_config ern_train_config_default(void) {
  ern_train_config config;
  ern_train_config_fill(&config, sizeof config);
  return config;
}

/* One trainer is used by one thread at a time; several may share a backend. */
typedef struct ern_trainer ern_trainer;

/* What a state was trained with. Plain data, may grow. */
typedef struct ern_train_state {
  bool torso;                        /* true: a torso was trained; false: a head */
  uint64_t step, seed;               /* steps done; ern_train_config.seed */
  int rays;                          /* ern_train_config.rays */
  bool has_settings;                 /* true: the state has the settings below; false: they are the defaults */
  uint64_t iters;                    /* as of ern_train_config, like the next three lines */
  float lr, lr_net, lr_att;          /* learning rates */
  uint64_t refresh_every, ema_every; /* intervals in steps */
  size_t data_begin, data_end;       /* training frames */
  bool torso_layer;                  /* ern_dataset.has_torso */
  bool ema;                          /* its model is the average */
  ern_precision precision;           /* as of ern_train_config */
  ern_ray_sampling ray_sampling;     /* likewise */
  double budget;                     /* ern_train_config.seconds; then `iters` is the number of steps as estimated
                                        after the last step */
  double seconds;                    /* of training, all runs together */
  bool refine_poses;                 /* ern_train_config.refine_poses */
  bool torso_gamma; /* ern_train_config.torso_gamma, also of a head: what its torso is to have; the next one likewise */
  bool torso_random_background;        /* likewise */
  int frames_per_step;                 /* ern_train_config.frames_per_step */
  uint64_t fine_steps;                 /* of iters; 0: no fine stage */
  int patch_size;                      /* as of ern_train_config, like the next line */
  float fine_weight, fine_lips_weight; /* likewise */
  char fine_loss[32];                  /* its name, "ssim" without ern_train_config.fine_loss */
  double fine_share;                   /* ern_train_config.fine_share */
  float prune_share;                   /* likewise */
  int step_parts;                      /* likewise */
  bool head_random_background;         /* as of ern_train_config */
  ern_train_config config; /* all settings that a state keeps (ern_setting.resume), the above among them; the others are
                              the defaults. Stays the last member, as it may grow */
} ern_train_state;
/* Describes the newest intact state in X.run, X being `output`, so that a program can resume it without having kept its
 * configuration: ern_trainer_create with `resume` refuses some other values, see there. Changes and locks nothing.
 * ERN_E_MISSING: there is no state; ERN_E_FORMAT and others: none is intact. *model: the configuration of the state's
 * model, and the settings that it is rendered with. */
ERN_API ERN_NODISCARD ern_status ern_train_state_describe_sized(ern_context *context, const char *output,
                                                                ern_train_state *state, size_t state_bytes,
                                                                ern_model_info *model, size_t model_bytes);
static inline ERN_NODISCARD ern_status ern_train_state_describe(ern_context *context, const char *output,
                                                                ern_train_state *state, ern_model_info *model) {
  return ern_train_state_describe_sized(context, output, state, sizeof *state, model, sizeof *model);
}

/* Checks data and configuration, takes the lock of X.run, and makes or loads the state. Nothing of an earlier training
 * is touched before the first save. `dataset` is copied; what it points to is not. config NULL: the defaults; its
 * strings and head are copied. `backend` must outlive the trainer.
 * ERN_E_BUSY: another process trains there. ERN_E_EXISTS: an earlier training is there, and neither resume nor
 * overwrite is set; or resume is set without overwrite, and the file X is no model of this clip, or a head where a
 * torso is trained, or the reverse. ERN_E_NONFINITE: a pose or feature is not finite. ERN_E_MISMATCH: the state or the
 * head belongs to another clip or configuration. ERN_E_STATE: the state to resume is beyond `iters`, or that of `from`
 * at `iters` or beyond. ERN_E_SHAPE: a member of `copies` has another shape than `features`. A resume must have these
 * as its state has them, else ERN_E_MISMATCH: the clip; whether a head or a torso is trained; backbone, attention,
 * eye_attention, levels, no_view, codes, bound, torso_gamma; has_eye, has_torso and scale of the dataset, its features
 * with copies, copy_share and speech_noise; data_begin, data_end, refine_poses, audio_pad and dt_gamma; of a torso also
 * torso_shrink and the weights of the head; with a fine stage the name of fine_loss. Other changes (learning rates,
 * rays, seed, iters, intervals, max_steps, precision) are logged as warnings. A torso must have its head's scale,
 * audio_pad, dt_gamma and max_steps. Differences from the file of `from` are logged. */
ERN_API ERN_NODISCARD ern_status ern_trainer_create_sized(ern_trainer **trainer, ern_backend *backend,
                                                          const ern_dataset *dataset, size_t dataset_bytes,
                                                          const ern_train_config *config);
static inline ERN_NODISCARD ern_status ern_trainer_create(ern_trainer **trainer, ern_backend *backend,
                                                          const ern_dataset *dataset, const ern_train_config *config) {
  return ern_trainer_create_sized(trainer, backend, dataset, sizeof *dataset, config);
}
ERN_API void ern_trainer_free(ern_trainer **trainer); /* accepts NULL and a pointer to NULL; does not save */

/* Plain data, may grow. */
typedef struct ern_train_report {
  uint64_t step, iters; /* steps done, and in all; with ern_train_config.seconds an estimate from the time of a
                           step so far */
  double loss, psnr;    /* of the rays, psnr in dB, and samples_per_ray: from ern_trainer_step those of this step, in a
                           progress hook of ern_trainer_run their means over the steps since the last report */
  double samples_per_ray;  /* mean */
  double steps_per_second; /* since the run began; 0 in ern_trainer_step */
  double seconds_left;     /* at that rate, or of ern_train_config.seconds; 0 in ern_trainer_step */
  double seconds;          /* time of all steps that this model was trained with, also in earlier runs; without saves
                              and validations */
} ern_train_report;

/* Where the training stands: step, iters and seconds; all else is 0. */
ERN_API void ern_trainer_describe_sized(const ern_trainer *trainer, ern_train_report *report, size_t bytes);
static inline void ern_trainer_describe(const ern_trainer *trainer, ern_train_report *report) {
  ern_trainer_describe_sized(trainer, report, sizeof *report);
}

/* One step, with its occupancy refresh where one is due. ERN_E_STATE: all steps are done, or the time is past. Neither
 * saves nor validates. A non-finite loss or gradient is ERN_E_NONFINITE, names step and term or tensor, and leaves the
 * parameters as they were before the step. */
ERN_API ERN_NODISCARD ern_status ern_trainer_step_sized(ern_trainer *trainer, ern_train_report *report, size_t bytes);
static inline ERN_NODISCARD ern_status ern_trainer_step(ern_trainer *trainer, ern_train_report *report) {
  return ern_trainer_step_sized(trainer, report, sizeof *report);
}

/* Looks at all that is kept from step to step: values, the last gradient, second moments, moving averages and
 * occupancy. ERN_E_NONFINITE names the first tensor with a NaN or an infinity. Costs less than a step. */
ERN_API ERN_NODISCARD ern_status ern_trainer_check(ern_trainer *trainer);

/* What ern_trainer_run tells its caller, in its thread. All may be NULL. Plain data, may grow. */
typedef struct ern_train_hooks {
  void *user; /* handed to the hooks */
  /* After a step: about twice a second, after each validation, and after the last step. A non-zero answer before the
   * last step stops: the state is saved, ERN_E_CANCELLED returned. */
  int (*progress)(void *user, const ern_train_report *report);
  /* After a validation: mean PSNR in dB over `frames` frames, and a picture of the first of them, RGB, uint8_t
   * [height][width][3]: rendered, recorded, 4 times their difference, audio attention and eye attention (the largest
   * value white) side by side, so `width` is five times that of a frame; and the name it should have
   * ("val_000400.png"). An error it returns is passed on. */
  ern_status (*validation)(void *user, uint64_t step, double psnr, size_t frames, const uint8_t *picture, int width,
                           int height, const char *name);
  /* Each frame of a validation before that: its split and number in the dataset, the rendered frame rgb (0..1) and the
   * recorded frame truth (0..255), both RGB, [height][width][3]. An error it returns is passed on; with
   * ERN_E_CANCELLED the state is saved, also after the last step. */
  ern_status (*validation_frame)(void *user, int split, size_t frame, const float *rgb, const uint8_t *truth);
} ern_train_hooks;

/* Trains until `iters` steps are done or `seconds` have passed. Blocks, saves and validates at the intervals of the
 * configuration and at the end. Where hooks->progress returns a value other than 0, it stops: the state is saved, and
 * the result is ERN_E_CANCELLED. Where a step fails, the steps since the last save are saved before the error is
 * returned, unless it is ERN_E_NONFINITE, ERN_E_DEVICE or ERN_E_NO_MEMORY. Where a validation fails, the state is
 * saved, but not after ERN_E_NONFINITE or ERN_E_DEVICE.
 * Without an output nothing is saved. hooks NULL: none. */
ERN_API ERN_NODISCARD ern_status ern_trainer_run_sized(ern_trainer *trainer, const ern_train_hooks *hooks,
                                                       size_t bytes);
static inline ERN_NODISCARD ern_status ern_trainer_run(ern_trainer *trainer, const ern_train_hooks *hooks) {
  return ern_trainer_run_sized(trainer, hooks, sizeof *hooks);
}

/* Writes X.run/state.safetensors (its predecessor stays as state.previous.safetensors) and then X. ERN_E_STATE without
 * an output. ERN_E_IO, with nothing touched, where X.run is not the folder any more that this training locked: it was
 * moved or replaced, or `output` is a relative name and the program has changed its working folder. */
ERN_API ERN_NODISCARD ern_status ern_trainer_save(ern_trainer *trainer);

/* A copy of the weights as they are; the caller owns it. With `ema` this is not the average: ern_trainer_save writes
 * that to `output`, which ern_model_load reads. */
ERN_API ERN_NODISCARD ern_status ern_trainer_model(ern_trainer *trainer, ern_model **model);

/* The folder X.run, NULL without an output. Lives as long as the trainer. */
ERN_API const char *ern_trainer_folder(const ern_trainer *trainer);

#ifdef __cplusplus
}
#endif
#endif
