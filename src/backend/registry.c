/* SPDX-License-Identifier: MIT
 * Lists the backends and selects one: the only file that names them. */
#include <stdlib.h>
#include <string.h>

#include "backend_cpu/backend_cpu.h"
#include "backend_opencl/backend_opencl.h"
#include "core/floats.h"
#include "core/machine.h"
#include "core/sized.h"
#include "core/status.h"
#include "ernerf/backend.h"

enum { CONFIG_COOKIE = 0x45524e38, TEXT_BYTES = 128 };

void ern_backend_config_fill(ern_backend_config *config, size_t bytes) {
  const ern_backend_config own = {.cookie = CONFIG_COOKIE, .name = "auto", .isa = "auto", .device = 0};
  ern_config_copy_out(config, bytes, &own, sizeof own);
}

/* bf16 is the default where it is measured to be faster, on the condition that it costs a rendered frame less than 0.05
 * dB of PSNR. It costs at most 0.01 dB over five models (docs/results.md; tests/numerics/test_bf16_price.c
 * checks the condition). */
static ern_isa best_isa(void) {
  static const ern_isa order[] = {ERN_ISA_AVX512, ERN_ISA_AVX2, ERN_ISA_NEON};
  if (ern_cpu_bf16_is_faster()) return ERN_ISA_AVX512BF16;
  for (size_t i = 0; i < sizeof order / sizeof *order; i++)
    if (ern_isa_available(order[i])) return order[i];
  return ERN_ISA_REF;
}

static ern_status choose_isa(ern_context *context, const char *wanted, ern_isa *isa) {
  char list[TEXT_BYTES];
  if (wanted == NULL || strcmp(wanted, "auto") == 0) wanted = getenv("ERNERF_ISA");
  if (wanted == NULL || wanted[0] == 0 || strcmp(wanted, "auto") == 0) {
    *isa = best_isa();
    return ERN_OK;
  }
  for (*isa = ERN_ISA_REF; *isa < ERN_ISAS; (*isa)++)
    if (strcmp(wanted, ern_isa_name(*isa)) == 0 && ern_isa_available(*isa)) return ERN_OK;
  ern_isa_list(list, sizeof list);
  return ern_fail(context, ERN_E_UNSUPPORTED,
                  "instruction set: found \"%s\", expected one that this machine has: auto %s", wanted, list);
}

ern_status ern_backend_create(ern_backend **backend, ern_context *context, const ern_backend_config *config) {
  ERN_PLAIN_FLOATS;
  if (backend != NULL) *backend = NULL;
  ERN_NEED(context, context);
  ERN_NEED(context, backend);
  ern_backend_config chosen = ern_backend_config_default();
  ern_isa isa = ERN_ISA_REF;
  ern_status status = ERN_OK;
  if (config != NULL) ERN_TRY(ERN_COPY_IN_CONFIG(context, ern_backend_config, &chosen, config));
  if (chosen.name != NULL && strcmp(chosen.name, "opencl") == 0) {
    /* the device has no instruction set, but an unknown name is an error */
    if (chosen.isa != NULL && strcmp(chosen.isa, "auto") != 0) {
      const ern_status known = choose_isa(context, chosen.isa, &isa);
      if (known != ERN_OK) return known;
    }
    const ern_status made = ern_opencl_backend_make(context, chosen.device, chosen.deterministic, chosen.tune, backend);
    if (made == ERN_OK)
      ern_log(context, ERN_LOG_INFO, "backend: opencl, device %d: %s", chosen.device, (*backend)->isa);
    return made;
  }
  if (chosen.name != NULL && strcmp(chosen.name, "auto") != 0 && strcmp(chosen.name, "cpu") != 0)
    return ern_fail(context, ERN_E_UNSUPPORTED, "backend: found \"%s\", expected auto, cpu or opencl", chosen.name);
  ERN_TRY(choose_isa(context, chosen.isa, &isa));
  ERN_TRY(ern_cpu_backend_make(context, isa, backend));
  ern_log(context, ERN_LOG_INFO, "backend: cpu, instruction set %s", ern_isa_name(isa));
fail:
  return status;
}

void ern_backend_free(ern_backend **backend) {
  if (backend == NULL || *backend == NULL) return;
  (*backend)->free(*backend);
  *backend = NULL;
}

void ern_backend_describe_sized(const ern_backend *backend, ern_backend_info *info, size_t bytes) {
  ern_backend_info own = {0};
  if (backend != NULL) {
    const int cores = ern_machine_cores();
    own = (ern_backend_info){.name = backend->name,
                             .isa = backend->isa,
                             .real_bytes = (int)backend->real_bytes,
                             .deterministic = backend->deterministic,
                             .threads = cores < ERN_THREADS_MOST ? cores : ERN_THREADS_MOST};
  }
  ern_struct_copy_out(info, bytes, &own, sizeof own);
}

void ern_backend_tuning(const ern_backend *backend, void (*say)(void *user, const ern_tuning *tuning), void *user) {
  if (backend == NULL || say == NULL) return;
  if (strcmp(backend->name, "opencl") == 0) ern_opencl_tuning(backend, say, user);
}

ern_status ern_devices_list(ern_context *context, void (*say)(void *user, const ern_device_info *device), void *user) {
  ERN_PLAIN_FLOATS;
  ERN_NEED(context, context);
  ERN_NEED(context, say);
  char name[TEXT_BYTES], list[TEXT_BYTES];
  ern_cpu_name(name, sizeof name);
  ern_isa_list(list, sizeof list);
  const ern_device_info cpu = {.kind = "cpu",
                               .name = name,
                               .version = "",
                               .driver = "",
                               .instruction_sets = list,
                               .deterministic = true,
                               .compute_units = (unsigned)ern_machine_cores(),
                               .memory_bytes = ern_machine_memory()};
  say(user, &cpu);
  return ern_opencl_devices_list(context, say, user);
}
